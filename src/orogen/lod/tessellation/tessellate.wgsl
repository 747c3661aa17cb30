#include tessellation.wgsl
#include pattern.wgsl
// The primitive generator and the evaluation stage: a workgroup a patch divides it, and puts its points on the ground.

struct Output {
    vertices: u32,
    instances: u32,
    first_vertex: u32,
    first_instance: u32,
    seen: u32,
    points: u32,
    triangles: u32,
}

@group(1) @binding(1) var<storage, read> patches: array<Patch>;
@group(1) @binding(2) var<storage, read> output: Output;
@group(1) @binding(3) var<storage, read_write> points: array<Evaluated>;
@group(1) @binding(4) var<storage, read_write> triangles: array<array<u32, 3>>;

// Subtexels of a share of a length, and what is left: x and y of the pair may differ.
fn share(parameter: vec2<u32>, size: vec2<u32>) -> Point {
    let low = (size & vec2<u32>(0xffffu)) * parameter;
    let whole = (size >> vec2<u32>(16u)) * parameter + (low >> vec2<u32>(16u));
    return Point(vec2<i32>(whole), vec2<f32>(low & vec2<u32>(0xffffu)) / f32(ONE));
}

fn evaluate(divided: Patch, parameter: vec2<u32>) -> Evaluated {
    let low = lattice_point(divided.place);
    let step = share(parameter, vec2<u32>(lattice_point(divided.place + 1u) - low));
    let p = Point(low + step.cell, step.frac);
    let halvings = firstLeadingBit(u32(max(divided.inner.x, divided.inner.y)));
    return Evaluated(p.cell, p.frac, height_at(p), divided.place.y << 16u | divided.place.x,
                     resident_level(p, u32(lod_at(p))), 6u - halvings);
}

@compute @workgroup_size(64)
fn tessellate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let number = group.y * GROUPS_A_ROW + group.x;
    if (number >= output.seen) { return; }
    let room = output.triangles <= tessellation.capacity;
    let divided = patches[number];
    var pattern: Pattern;
    pattern.bare = true;
    pattern.points = 4u;
    pattern.triangles = 2u;
    if (room) { pattern = pattern_of(divided.outer, divided.inner); }
    let first_point = select(4u * number, divided.first_point, room);
    let first_triangle = select(2u * number, divided.first_triangle, room);
    for (var n = thread; n < pattern.points; n += 64u) {
        points[first_point + n] = evaluate(divided, parameters(&pattern, n));
    }
    for (var n = thread; n < pattern.triangles; n += 64u) {
        let corners = triangle_of(&pattern, n) + first_point;
        triangles[first_triangle + n] = array<u32, 3>(corners.x, corners.y, corners.z);
    }
}
