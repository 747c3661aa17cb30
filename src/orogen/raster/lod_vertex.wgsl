#include clipmap.wgsl

struct LodVertex {
    point: Point,
    height: f32,         // metres of the data
    lines: vec4<f32>,    // triangle edges lie where one of these is a whole number; 0.5 where there are fewer than four
    id: u32,
    level: u32,          // of the data
    tile_level: u32,     // of the geometry
}

const WITH_LEVELS = #{WITH_LEVELS};    // false where only the places of vertices are asked for: levels take time to find

// Level of the data that a point is drawn from.
fn drawn_level(p: Point) -> u32 {
    if (!WITH_LEVELS) { return 0u; }
    return resident_level(p, u32(lod_at(p)));
}
