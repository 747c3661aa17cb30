#include frame.wgsl

struct LodVertex {
    point: Point,
    height: f32,         // metres of the data
    grid: vec2<f32>,     // place in the patch, in quads: triangle edges lie on whole numbers and on the falling diagonals
    id: u32,
    level: u32,          // of the data
    tile_level: u32,     // of the geometry
}
