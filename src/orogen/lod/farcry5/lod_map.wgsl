#include farcry5.wgsl
// The LOD map: which nodes are drawn. Per level a window of nodes around the LOD eye, addressed modulo its side, in place
// of one texel per smallest node of the whole terrain; the levels are looked through from fine to coarse.

@group(1) @binding(2) var<storage, read_write> lod_map: array<u32>;   // 1 where the node is drawn

fn in_window(node: vec2<i32>, level: u32) -> bool {
    let inside = node - farcry.origins[level].xy;
    return all(inside >= vec2<i32>(0)) && all(inside < vec2<i32>(1i << farcry.map_bits));
}

fn map_index(node: vec2<i32>, level: u32) -> u32 {
    let wrapped = vec2<u32>(node) & vec2<u32>((1u << farcry.map_bits) - 1u);
    return ((level << farcry.map_bits) | wrapped.y) << farcry.map_bits | wrapped.x;
}

fn is_drawn(node: vec2<i32>, level: u32) -> bool {
    return in_window(node, level) && lod_map[map_index(node, level)] == 1u;
}

// Whether the ground of a node is drawn more than so many levels coarser.
fn is_drawn_coarser(node: vec2<i32>, level: u32, steps: u32) -> bool {
    for (var step = steps + 1u; level + step <= farcry.root_level; step += 1u) {
        if (is_drawn(node >> vec2<u32>(step), level + step)) { return true; }
    }
    return false;
}

// How many levels coarser than `level` the ground of a node is drawn; 0 where it is drawn as fine, finer or not at all.
fn steps_to_coarser(node: vec2<i32>, level: u32) -> u32 {
    for (var step = 0u; level + step <= farcry.root_level; step += 1u) {
        if (is_drawn(node >> vec2<u32>(step), level + step)) { return step; }
    }
    return 0u;
}
