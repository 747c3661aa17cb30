#include frame.wgsl

struct LodVertex {
    point: Point,
    height: f32,         // metres of the data
    lines: vec4<f32>,    // triangle edges lie where one of these is a whole number; 0.5 where there are fewer than four
    id: u32,
    level: u32,          // of the data
    tile_level: u32,     // of the geometry
}
