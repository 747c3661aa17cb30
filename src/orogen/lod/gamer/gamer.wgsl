#include clipmap.wgsl
// Generic adaptive mesh refinement: the coarse mesh, a lattice of cells of two triangles each.

struct Gamer {
    cells: vec2<u32>,        // columns and rows of the lattice
    side: u32,               // samples along a cell's side
    groups: u32,             // workgroups that choose patterns
    width: f32,              // metres along the longer side of a cell
    pixels: f32,
    padding: vec2<f32>,
}

// A vertex of the coarse mesh: its height in metres of the data, and how deep the triangles around it should be.
struct CoarseVertex { height: f32, tag: f32 }

@group(1) @binding(0) var<uniform> gamer: Gamer;

// Point of the lattice. Cells at the far sides end with the data.
fn lattice_point(corner: vec2<u32>) -> vec2<i32> {
    let steps = (corner * gamer.side) << vec2<u32>(frame.subtexel_bits);
    return min(frame.extent.xy + vec2<i32>(steps), frame.extent.zw);
}

// Corners of a coarse triangle as points of the lattice: the right angle, then along the row, then along the column.
fn corners_of(triangle: u32) -> array<vec2<u32>, 3> {
    let cell = vec2<u32>((triangle >> 1u) % gamer.cells.x, (triangle >> 1u) / gamer.cells.x);
    let half = triangle & 1u;
    return array<vec2<u32>, 3>(cell + half, cell + vec2<u32>(1u - half, half), cell + vec2<u32>(half, 1u - half));
}
