#include clipmap.wgsl
// Recursive adaptive refinement (Schmiade 2008, section 4): the triangles, their edges, and the camera that decides.

const RIGHT_ANGLED = #{RIGHT_ANGLED};   // forced vertices are interpolated on their edge
const MOVED = #{MOVED};                 // new vertices stand at the worst sample of an edge
const SAMPLES = #{SAMPLES}u;            // samples looked at on an edge
const GROUP = 256u;

struct Rag {
    right: vec4<f32>,              // of the LOD camera: metres to pixels across at view depth 1
    up: vec4<f32>,
    depth: vec4<f32>,              // metres to view depth, 1 everywhere for an orthographic camera
    planes: array<vec4<f32>, 5>,   // its frustum
    anchor: vec2<i32>,             // subtexels that it stands at, and their fraction
    offset: vec2<f32>,
    eye: vec3<f32>,                // where distances start, metres relative to it
    eye_height: f32,               // its height in metres of the data
    margin: vec2<f32>,             // a pixel in metres, per metre of distance and in all
    far: f32,                      // metres to the farthest corner of the data
    depth_detail: f32,
    threshold: f32,
    capacity: u32,                 // triangles that a list has room for
    finest: i32,                   // subtexels that edges have to be longer than to be split
    cell_bits: u32,                // cells of the coarse mesh are 2^cell_bits samples wide
    cells: vec2<u32>,              // columns and rows of the coarse mesh
    last: vec2<u32>,               // column and row of the last sample
}

struct State {
    count: u32,        // triangles in the list
    half: u32,         // which of the two lists they are in
    next: u32,         // triangles that the next list gets; 0: it is not written
    drawn: u32,        // triangles that are drawn
    drawn_half: u32,
    needed: u32,       // room that was lacking; 0: there was enough
}

// A vertex: subtexels, and metres of the data.
struct Vertex { x: i32, y: i32, height: f32 }

// The longest edge of a right-angled triangle lies between the second and the third corner (section 5.1.2). Edges have
// the number of the corner across. `settled`: a bit for each edge that has been looked at and stays whole.
struct Triangle { corners: array<Vertex, 3>, settled: u32 }

@group(1) @binding(0) var<uniform> rag: Rag;

fn cell_of(corner: Vertex) -> vec2<i32> { return vec2<i32>(corner.x, corner.y); }

fn middle_cell(a: Vertex, b: Vertex) -> vec2<i32> { return (cell_of(a) + cell_of(b)) >> vec2<u32>(1u); }

// On the straight line between its ends: what lies there is invisible (section 4.2.1).
fn interpolated(a: Vertex, b: Vertex) -> Vertex {
    let cell = middle_cell(a, b);
    return Vertex(cell.x, cell.y, 0.5 * (a.height + b.height));
}

fn fetched(cell: vec2<i32>) -> Vertex {
    return Vertex(cell.x, cell.y, height_at(Point(cell, vec2<f32>(0.0))));
}

// The greater of an edge's lengths in columns and rows, subtexels.
fn reach(a: Vertex, b: Vertex) -> i32 {
    let step = abs(cell_of(b) - cell_of(a));
    return max(step.x, step.y);
}
