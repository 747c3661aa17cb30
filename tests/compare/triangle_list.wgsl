#include frame.wgsl
#include lod_vertex.wgsl
// Corners that a test wrote: whole subtexels, their fractions, and heights.

struct GivenVertex { cell: vec2<i32>, frac: vec2<f32>, height: f32, unused: f32 }

@group(1) @binding(0) var<storage, read> given: array<GivenVertex>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let v = given[vertex + instance * #{EACH}u];
    return LodVertex(Point(v.cell, v.frac), v.height, vec4<f32>(0.5), instance, 0u, 0u);
}
