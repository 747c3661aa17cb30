#include lod_map.wgsl
#include prism.wgsl
#include patch_word.wgsl
// From nodes to patches (Kuehnert 2022, figure 3.12): one workgroup a node, one invocation a patch.

const FRUSTUM = #{FRUSTUM};
const BACK_FACE = #{BACK_FACE};

struct State {
    level: u32,
    parents: u32,
    children: u32,
    nodes: u32,
    patches: atomic<u32>,
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(3) var<storage, read_write> nodes: array<NodeTile>;
@group(1) @binding(4) var<storage, read_write> patches: array<PatchTile>;

fn is_visible(low: vec2<i32>, high: vec2<i32>) -> bool {
    if (!FRUSTUM || !prism_outside_frustum(prism_over(low, high))) { return true; }
    // the ground at the eye tells whether undersides can be seen
    return BACK_FACE && flat_distance(low, high) <= farcry.near_reach;
}

// Levels that the ground beyond each side of a patch is coarser: only sides of the node have other levels beyond.
fn steps_beyond(node: NodeTile, place: vec2<u32>) -> vec4<u32> {
    let at = vec2<i32>(vec2<u32>(node.x, node.y));
    var steps = vec4<u32>(0u);
    if (place.x == 0u) { steps.x = steps_to_coarser(at - vec2<i32>(1, 0), node.level); }
    if (place.x == PATCHES - 1u) { steps.y = steps_to_coarser(at + vec2<i32>(1, 0), node.level); }
    if (place.y == 0u) { steps.z = steps_to_coarser(at - vec2<i32>(0, 1), node.level); }
    if (place.y == PATCHES - 1u) { steps.w = steps_to_coarser(at + vec2<i32>(0, 1), node.level); }
    return steps;
}

@compute @workgroup_size(64)
fn list_patches(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = group.y * ROW + group.x;
    if (index >= state.nodes) { return; }
    let node = nodes[index];
    let place = vec2<u32>(local % PATCHES, local / PATCHES);
    let at = vec2<u32>(node.x, node.y) * PATCHES + place;
    let low = lattice_corner(at.x, at.y, QUADS, node.level);
    if (any(low >= frame.extent.zw)) { return; }
    let high = min(low + quad_size(node.level) * i32(QUADS), frame.extent.zw);
    if (!is_visible(low, high)) { return; }
    let slot = atomicAdd(&state.patches, 1u);
    // what finds no room is counted: the list grows to hold it
    if (slot < farcry.capacity) { patches[slot] = make_patch(at, node.level, steps_beyond(node, place)); }
}
