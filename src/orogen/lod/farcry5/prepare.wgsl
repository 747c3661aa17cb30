#include farcry5.wgsl
// Between two passes: counts of the one before become the arguments of the next.

struct State {
    level: u32,
    parents: u32,
    children: u32,
    nodes: u32,
    patches: u32,
    visible: u32,
    hidden: u32,
    revealed: u32,
    undersides: u32,
}

struct Groups { x: u32, y: u32, z: u32 }

struct Draw { indices: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32 }

struct Arguments {
    refine: Groups,
    patches: Groups,
    measure: Groups,
    cull: Groups,
    reveal: Groups,
    draw: Draw,
    draw_revealed: Draw,
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(2) @binding(0) var<storage, read_write> arguments: Arguments;

const INDICES = 6u * QUADS * QUADS;

fn one_each(count: u32) -> Groups { return Groups(min(count, ROW), (count + ROW - 1u) / ROW, 1u); }

fn in_64s(count: u32) -> Groups { return Groups((count + 63u) / 64u, 1u, 1u); }

@compute @workgroup_size(1)
fn prepare_root() {
    // before the first data has come there is nothing to draw
    let empty = clipmap.layers[HEIGHTS].present == 0u || any(frame.extent.xy >= frame.extent.zw);
    let roots = select(1u, 0u, empty);
    state = State(farcry.root_level, roots, 0u, 0u, 0u, 0u, 0u, 0u, 0u);
    arguments.refine = Groups(roots, 1u, 1u);
}

@compute @workgroup_size(1)
fn prepare_next() {
    state.level -= 1u;
    state.parents = state.children;
    state.children = 0u;
    arguments.refine = in_64s(state.parents);
}

@compute @workgroup_size(1)
fn prepare_patches() { arguments.patches = one_each(state.nodes); }

@compute @workgroup_size(1)
fn prepare_culling() {
    let count = min(state.patches, farcry.capacity);
    arguments.measure = one_each(count);
    arguments.cull = in_64s(count);
}

@compute @workgroup_size(1)
fn prepare_draw() {
    arguments.draw = Draw(INDICES, state.visible, 0u, 0u, 0u);
    arguments.reveal = in_64s(state.hidden);
}

@compute @workgroup_size(1)
fn prepare_second_draw() { arguments.draw_revealed = Draw(INDICES, state.revealed, 0u, 0u, 0u); }
