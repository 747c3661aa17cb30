#include clipmap.wgsl
#include mesh.wgsl
// The coarse mesh: a lattice over the data's extent. Everything is in integers, so that neighbours agree to the bit.

const CELL_BITS = #{CELL_BITS}u;            // log2 of samples along a cell's side

struct Corners { a: vec2<i32>, b: vec2<i32>, c: vec2<i32> }

// Vertex of the lattice. Cells are a power of two of samples wide, so that patterns have vertices on samples; those at
// the far sides end with the data.
fn lattice_vertex(place: vec2<u32>) -> vec2<i32> {
    return min(frame.extent.xy + vec2<i32>(place << vec2<u32>(CELL_BITS + frame.subtexel_bits)), frame.extent.zw);
}

// A cell has two triangles, with the right angle at c and the cell's diagonal from a to b.
fn coarse_corners(number: u32) -> Corners {
    let cell = vec2<u32>(number / 2u % COLUMNS, number / 2u / COLUMNS);
    let low = lattice_vertex(cell);
    let high = lattice_vertex(cell + 1u);
    if (number % 2u == 0u) { return Corners(low, high, vec2<i32>(high.x, low.y)); }
    return Corners(high, low, vec2<i32>(low.x, high.y));
}

// Barycentric to subtexels, rounded down. The sum is the same in whatever order, and wherever it is counted from: a
// place on an edge comes out the same for both triangles.
fn cartesian(corners: Corners, corner: u32) -> vec2<i32> {
    let share = vec3<i32>(vec3<u32>(corner, corner >> 8u, 0u) & vec3<u32>(255u));
    let weights = vec3<i32>(share.xy, (1i << DEPTH) - share.x - share.y);
    let low = min(corners.a, corners.b);
    let x = vec3<i32>(corners.a.x, corners.b.x, corners.c.x) - low.x;
    let y = vec3<i32>(corners.a.y, corners.b.y, corners.c.y) - low.y;
    return low + vec2<i32>(weighed(x, weights), weighed(y, weights));
}

// Weights are parts of 2^DEPTH; quotient and remainder apart so that products fit.
fn weighed(along: vec3<i32>, weights: vec3<i32>) -> i32 {
    let quotient = along >> vec3<u32>(DEPTH);
    let rest = weights * (along - (quotient << vec3<u32>(DEPTH)));
    let whole = weights * quotient;
    return whole.x + whole.y + whole.z + ((rest.x + rest.y + rest.z) >> DEPTH);
}
