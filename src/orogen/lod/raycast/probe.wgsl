#include trace.wgsl
// Rays from a list, for questions that are not about pixels.

struct ProbeRay { origin: vec3<f32>, start: f32, direction: vec3<f32>, end: f32 }

struct ProbeHit {
    t: f32,         // along the ray; below its start for a miss
    height: f32,    // metres of the data
    level: u32,     // of the data
    padding: u32,
}

@group(1) @binding(0) var<storage, read> probe_rays: array<ProbeRay>;
@group(1) @binding(1) var<storage, read_write> probe_hits: array<ProbeHit>;

@compute @workgroup_size(64)
fn cast_probes(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= arrayLength(&probe_rays)) { return; }
    let probe = probe_rays[id.x];
    let hit = trace(Ray(probe.origin, probe.direction), probe.start, probe.end, true);
    if (!hit.found) {
        probe_hits[id.x] = ProbeHit(-3e38, 0.0, 0u, 0u);
        return;
    }
    let height = world_height(probe.origin + hit.t * probe.direction);
    probe_hits[id.x] = ProbeHit(hit.t, height, hit.level, 0u);
}
