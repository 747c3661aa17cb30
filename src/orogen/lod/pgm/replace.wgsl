#include trace.wgsl
#include ray_hit.wgsl
// Rays through the pixels that show a prism: what they meet is exact.

const FLAG = 0x80000000u;

@group(1) @binding(0) var<storage, read_write> rays: atomic<u32>;

fn lod_replaces(pixel: vec2<u32>, depth: f32, id: u32, detail: u32) -> bool {
    if (id != FLAG) { return false; }
    atomicAdd(&rays, 1u);
    return true;
}

fn lod_ray(ray: Ray, from_t: f32, to_t: f32) -> RayHit {
    let hit = trace(ray, from_t, to_t, true);
    if (!hit.found) { return RayHit(MISS, 0u, 0u, 0u, 0.0); }
    return RayHit(hit.t, FLAG, hit.level, hit.level, 1e3);
}
