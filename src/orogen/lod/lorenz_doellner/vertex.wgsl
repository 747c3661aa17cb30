#include lattice.wgsl
#include lod_vertex.wgsl
// Pass 3, rendering: barycentric to cartesian, then onto the ground.

struct Drawn { draw: vec4<u32>, half: u32 }   // the beginning of State

@group(1) @binding(0) var<storage, read> state: Drawn;
@group(1) @binding(1) var<storage, read> mesh: array<SubTriangle>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let corner = vertex % 3u;
    let triangle = mesh[state.half * (arrayLength(&mesh) / 2u) + vertex / 3u];
    let number = triangle.key >> NUMBER_BITS;
    let p = Point(cartesian(coarse_corners(number), triangle.corners[corner]), vec2<f32>(0.0));
    // 0 on the edge opposite a corner
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(corner) == vec3<u32>(0u, 1u, 2u)), 0.5);
    let tile_level = DEPTH - (triangle.corners[0] >> #{DEPTH_BITS}u);
    return LodVertex(p, height_at(p), lines, number, drawn_level(p), tile_level);
}
