#include farcry5.wgsl
#include box.wgsl
#include lod/depth_pyramid.wgsl
// The patches to draw, one invocation a patch: first those that the depth of the frame before does not hide, then, when
// these are drawn, those among the rest that they do not hide either.

const FRUSTUM = #{FRUSTUM};
const BACK_FACE = #{BACK_FACE};
const OCCLUSION = #{OCCLUSION};

struct State {
    level: u32,
    parents: u32,
    children: u32,
    nodes: u32,
    patches: u32,
    visible: atomic<u32>,
    hidden: atomic<u32>,
    revealed: atomic<u32>,
    undersides: u32,
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> boxes: array<Box>;
// numbers of patches: visible ones from the start, hidden ones backwards from the middle, revealed ones after it
@group(1) @binding(3) var<storage, read_write> lists: array<u32>;

fn outside_frustum(box: Box) -> bool {
    let slack = 1e-6 * (length(max(abs(box.low), abs(box.high))));
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let corner = select(box.low, box.high, plane.xyz > vec3<f32>(0.0));
        if (dot(plane.xyz, corner) + plane.w < -slack) { return true; }
    }
    return false;
}

fn shows_only_undersides(box: Box) -> bool {
    return farcry.drop_undersides == 1u && state.undersides == 0u && box.front == 0u;
}

@compute @workgroup_size(64)
fn cull_patches(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= min(state.patches, farcry.capacity)) { return; }
    if (FRUSTUM || BACK_FACE || OCCLUSION) {
        let box = boxes[id.x];
        if (FRUSTUM && outside_frustum(box)) { return; }
        if (BACK_FACE && shows_only_undersides(box)) { return; }
        if (OCCLUSION && farcry.history == 1u && is_hidden(box.low, box.high, 1.0, farcry.to_history)) {
            lists[farcry.capacity - 1u - atomicAdd(&state.hidden, 1u)] = id.x;
            return;
        }
    }
    lists[atomicAdd(&state.visible, 1u)] = id.x;
}

@compute @workgroup_size(64)
fn reveal_patches(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= atomicLoad(&state.hidden)) { return; }
    let number = lists[farcry.capacity - 1u - id.x];
    if (!is_hidden(boxes[number].low, boxes[number].high, 1.0, frame.view_projection)) {
        lists[farcry.capacity + atomicAdd(&state.revealed, 1u)] = number;
    }
}
