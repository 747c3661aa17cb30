#include clipmap.wgsl
// Brute-force hardware tessellation (Houska 2019, section 2.3.6): the lattice of patches, and what the stages hand on.

struct Tessellation {
    patches: vec2<u32>,      // columns and rows of the lattice
    side: u32,               // samples along a patch's side
    capacity: u32,           // triangles that there is room for
    pixels_per_quad: f32,
    max_factor: f32,
    padding: vec2<u32>,
}

// Length of an edge and its distance to the LOD eye in metres, and the parts that it is divided into.
struct Edge { size: f32, distance: f32, factor: f32 }

// A patch after the control stage: its factors, and where its points and triangles go.
struct Patch {
    place: vec2<u32>,        // column and row
    first_point: u32,
    first_triangle: u32,
    outer: vec4<f32>,        // along the west, north, east and south edge
    inner: vec2<f32>,        // from west to east, from north to south
    padding: vec2<u32>,
}

// A vertex after the evaluation stage.
struct Evaluated {
    cell: vec2<i32>,
    frac: vec2<f32>,
    height: f32,
    id: u32,
    level: u32,
    tile_level: u32,
}

const GROUPS_A_ROW = 1024u;   // of the dispatch that divides the patches

@group(1) @binding(0) var<uniform> tessellation: Tessellation;

// Point of the lattice. Patches at the far sides end with the data.
fn lattice_point(corner: vec2<u32>) -> vec2<i32> {
    let steps = (corner * tessellation.side) << vec2<u32>(frame.subtexel_bits);
    return min(frame.extent.xy + vec2<i32>(steps), frame.extent.zw);
}
