#include clipmap.wgsl
#include lod_vertex.wgsl
// Vertices at any place: offsets from the first sample in subtexels and heights in metres, from a list.

@group(1) @binding(0) var<storage, read> soup: array<vec4<f32>>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let v = soup[vertex];
    let shift = f32(instance) * 40.0;
    let cell = frame.extent.xy + vec2<i32>(floor(v.xy + shift));
    return LodVertex(Point(cell, fract(v.xy + shift)), v.z, vec4<f32>(0.5), vertex + 1000u * instance, vertex % 7u, 3u);
}
