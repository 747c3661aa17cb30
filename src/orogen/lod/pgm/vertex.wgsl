#include pgm.wgsl
#include lod_vertex.wgsl
// The grid as one triangle strip per row of cells (Houska 2019, section 3.2.1); an instance is a row.

@group(1) @binding(2) var<storage, read> placed: array<Placed>;

// Column and row of a strip's vertex.
fn grid_vertex(vertex: u32, strip: u32) -> vec2<u32> {
    if (TESSELLATION == 0u) { return vec2<u32>(vertex / 2u, strip + (vertex & 1u)); }
    // diamonds: the strip starts in the row that is not shifted
    if (DIAMOND) { return vec2<u32>(vertex / 2u, strip + ((vertex ^ strip) & 1u)); }
    // symmetric: rising diagonals, then, after a vertex that comes twice, falling ones (figure 3.7)
    let turn = 2u * (pgm.columns / 2u) + 1u;
    if (vertex <= turn) { return vec2<u32>(vertex / 2u, strip + 1u - (vertex & 1u)); }
    return vec2<u32>((vertex - 1u) / 2u, strip + ((vertex - 1u) & 1u));
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let at = grid_vertex(vertex, instance);
    let v = placed[at.y * (pgm.columns + 1u) + at.x];
    let x = place_in_row(at.x, at.y);
    let y = f32(at.y);
    var lines = vec4<f32>(x, y, x + y, 0.5);
    if (TESSELLATION == 1u) { lines.z = abs(x - f32(pgm.columns / 2u)) + y; }
    if (DIAMOND) { lines = vec4<f32>(y, x + 0.5 * (y + 1.0), x - 0.5 * (y + 1.0), 0.5); }
    return LodVertex(Point(v.cell, v.frac), v.height, lines, instance + 1u, v.levels & 0xffu, v.levels >> 8u);
}
