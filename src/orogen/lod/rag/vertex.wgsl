#include rag.wgsl
#include lod_vertex.wgsl

@group(1) @binding(1) var<storage, read> triangles: array<Triangle>;
@group(1) @binding(2) var<storage, read> state: State;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    var corners = triangles[state.drawn_half * rag.capacity + vertex / 3u].corners;
    let number = vertex % 3u;
    let corner = corners[number];
    let p = Point(cell_of(corner), vec2<f32>(0.0));
    // 0 on the edge opposite a corner
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(number) == vec3<u32>(0u, 1u, 2u)), 0.5);
    let sum = vec2<u32>(cell_of(corners[0]) + cell_of(corners[1]) + cell_of(corners[2]));
    let id = (sum.y * 0x9e3779b1u) ^ sum.x;
    let legs = max(reach(corners[0], corners[1]), reach(corners[0], corners[2]));
    let size = u32(max(legs, reach(corners[1], corners[2])));
    return LodVertex(p, corner.height, lines, id, drawn_level(p), firstLeadingBit(max(size, 1u)));
}
