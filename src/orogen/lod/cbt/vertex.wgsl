#include cbt.wgsl
#include lod_vertex.wgsl

@group(1) @binding(1) var<storage, read> nodes: array<u32>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let node = nodes[vertex / 3u];
    let t = triangle_of(node);
    let corner = vertex % 3u;
    let at = select(select(t.last, t.first, corner == 1u), t.apex, corner == 0u);
    // corners beyond the data move to its border, which keeps triangles from overlapping
    let p = clamp_to_extent(Point(frame.extent.xy + at, vec2<f32>(0.0)));
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(0u, 1u, 2u) == vec3<u32>(corner)), 0.5);
    return LodVertex(p, height_at(p), lines, node, drawn_level(p), cbt.finest - depth_of_node(node));
}
