// The cells of the grid: four vertices and a diagonal.

const FLAG = 0x80000000u;     // id of what is to be ray cast

struct Prism { cell: u32, low: f32, high: f32 }

// Number of a cell's vertex: near left, near right, far left, far right.
fn vertex_number(at: vec2<u32>, corner: u32) -> u32 {
    return (at.y + corner / 2u) * (pgm.columns + 1u) + at.x + (corner & 1u);
}

// Whether the diagonal goes from near left to far right, as vertex.wgsl draws it.
fn is_rising(at: vec2<u32>) -> bool {
    if (DIAMOND) { return (at.y & 1u) == 1u; }
    return TESSELLATION == 1u && at.x < pgm.columns / 2u;
}

// Corners of a cell such that the first three and the last three are its triangles.
fn triangles_of(at: vec2<u32>) -> array<u32, 4> {
    if (is_rising(at)) { return array<u32, 4>(1u, 0u, 3u, 2u); }
    return array<u32, 4>(0u, 1u, 2u, 3u);
}
