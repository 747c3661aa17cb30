#include clipmap.wgsl
// The tiles: a quadtree over a fixed lattice (Kuehnert 2022, sections 4.4 and 5.1).
//
// Quads of level 0 are `leaf` subtexels wide, those of level l 2^l times that, counted from the first sample's centre. A
// tile is split while its nearest point is closer than the distance at which its quads cover `pixels_per_quad` pixels
// (Houska 2019, equation 2.3).

struct Tiling {
    grid_size: u32,        // quads along a tile's side
    leaf: u32,             // subtexels along a quad of level 0
    root_level: u32,       // level whose single tile covers the data
    tile_capacity: u32,
    split_distance: f32,   // metres within which a tile of level 1 is split; twice that for level 2 and so on
    morph_range: f32,      // share of a level's range in which its vertices move to the next level's
    history: u32,          // 1: there is a depth pyramid of the frame before
    foreground: f32,       // metres beyond which tiles are put aside when there is none
    to_history: mat4x4<f32>,   // camera-relative metres to the clip space of the frame before
}

struct Tile { x: u32, y: u32, level: u32 }

// `node`: slot and level of the one node that all its heights come from, packed as in the node table, or MANY_NODES.
struct FinalTile { x: u32, y: u32, level: u32, node: u32 }

const MANY_NODES = 0xffffffffu;

@group(1) @binding(0) var<uniform> tiling: Tiling;

fn quad_size(level: u32) -> i32 { return i32(tiling.leaf << level); }

fn tile_corner(tile: Tile) -> vec2<i32> {
    return frame.extent.xy + vec2<i32>(vec2<u32>(tile.x, tile.y)) * (quad_size(tile.level) * i32(tiling.grid_size));
}

// Where level l is fully morphed into level l + 1, and where tiles of level l + 1 are split.
fn range_end(level: u32) -> f32 { return tiling.split_distance * f32(1u << level); }

// The same as height_at, to the bit, without looking for the node where the tile knows it.
fn tile_height(p: Point, node: u32) -> f32 {
    if (node == MANY_NODES) { return height_at(p); }
    let level = node >> 16u;
    return node_height(p, Node(node & 0xffffu, level, p.cell >> vec2<u32>(frame.subtexel_bits + NODE_BITS + level), level));
}
