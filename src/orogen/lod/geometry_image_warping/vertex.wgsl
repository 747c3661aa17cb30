#include image.wgsl
#include lod_vertex.wgsl
// The geometry image as quads: an instance is a row of cells, drawn as a triangle strip.

@group(1) @binding(1) var<storage, read> mesh: array<Pixel>;

// Level of the data whose samples are as far apart as the vertices around.
fn level_of_cell(at: vec2<u32>) -> u32 {
    let next = min(at + 1u, vec2<u32>(settings.columns, settings.rows));
    let low = mesh[(next.y - 1u) * (settings.columns + 1u) + next.x - 1u].at;
    let high = mesh[next.y * (settings.columns + 1u) + next.x].at;
    return u32(log2(max(distance(low, high) * inverse_power(frame.subtexel_bits) * inverseSqrt(2.0), 1.0)));
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let at = vec2<u32>(vertex / 2u, instance + (vertex & 1u));
    let pixel = mesh[at.y * (settings.columns + 1u) + at.x];
    let p = ground_of(pixel);
    let lines = vec4<f32>(vec2<f32>(at), f32(at.x + at.y), 0.5);
    let level = drawn_level(p);
    return LodVertex(p, pixel.height, lines, instance + 1u, level, level_of_cell(at));
}
