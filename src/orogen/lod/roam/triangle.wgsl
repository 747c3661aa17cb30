#include lod/bintree.wgsl
#include lod_vertex.wgsl

// A corner of the list, `shift` metres over its place.
fn corner_vertex(vertex: u32, shift: f32) -> LodVertex {
    let triangle = triangles[vertex / 3u];
    let corner = vertex % 3u;
    let p = lattice_point(corner_of(triangle, corner) * UNIT);
    // edges lie where a corner's share of the triangle is 0
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(0u, 1u, 2u) == vec3<u32>(corner)), 0.5);
    let level = drawn_level(p);
    return LodVertex(p, height_beyond(p) + shift, lines, id_of(triangle), level, level_of(triangle));
}
