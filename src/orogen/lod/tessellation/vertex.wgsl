#include tessellation.wgsl
#include lod_vertex.wgsl
// Vertices are not shared between triangles, so that each can tell its three edges apart.

@group(1) @binding(1) var<storage, read> points: array<Evaluated>;
@group(1) @binding(2) var<storage, read> triangles: array<u32>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let point = points[triangles[vertex]];
    let corner = vertex % 3u;
    // 0 on the edge opposite a corner
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(corner) == vec3<u32>(0u, 1u, 2u)), 0.5);
    return LodVertex(Point(point.cell, point.frac), point.height, lines, point.id, point.level, point.tile_level);
}
