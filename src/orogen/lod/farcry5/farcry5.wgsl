#include clipmap.wgsl
// The terrain renderer of Far Cry 5 (Kuehnert 2022, section 3.7): nodes, their patches, and the LOD map.
//
// Nodes lie on a fixed lattice: quads of level 0 are `leaf` subtexels wide, those of level l 2^l times that, counted from
// the first sample's centre. A node has 8 x 8 patches, a patch QUADS x QUADS quads.

const QUADS = #{QUADS}u;
const PATCHES = 8u;               // along a node's side
const NODE_QUADS = PATCHES * QUADS;
const NODE_QUADS_BITS = #{NODE_QUADS_BITS}u;   // their logarithm
const ROW = 32768u;               // workgroups in a row of a long dispatch

struct FarCry {
    leaf: u32,               // subtexels along a quad of level 0
    root_level: u32,         // level whose single node covers the data
    floor_level: u32,        // no node of this level or below can be near enough to be split
    map_bits: u32,           // the LOD map's windows are 2^bits nodes wide
    capacity: u32,           // patches that there is room for
    drop_undersides: u32,    // 1: the eye can see the terrain from above only, unless it is all but inside
    history: u32,            // 1: there is a depth pyramid of the frame before
    split_distance: f32,     // metres within which a node of level 1 is split; twice that for level 2 and so on
    near_reach: f32,         // metres from the eye to the corners of the near plane
    to_history: mat4x4<f32>,            // camera-relative metres to the clip space of the frame before
    origins: array<vec4<i32>, 32>,      // per level: first node column and row of the LOD map's window
}

struct NodeTile { x: u32, y: u32, level: u32 }

@group(1) @binding(0) var<uniform> farcry: FarCry;

fn quad_size(level: u32) -> i32 { return i32(farcry.leaf << level); }

fn lattice_corner(x: u32, y: u32, quads: u32, level: u32) -> vec2<i32> {
    return frame.extent.xy + vec2<i32>(vec2<u32>(x, y)) * (quad_size(level) * i32(quads));
}

fn node_corner(node: NodeTile) -> vec2<i32> { return lattice_corner(node.x, node.y, NODE_QUADS, node.level); }

// Distance within which nodes of a level are split.
fn split_distance(level: u32) -> f32 { return farcry.split_distance * f32(1u << level) * 0.5; }
