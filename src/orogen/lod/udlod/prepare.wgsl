#include udlod.wgsl
// Between two levels of refinement: swap the ends of the list and set up the next dispatch (Kuehnert 2022, figure 5.2).

struct State { parents: u32, children: u32, finals: u32, backwards: u32, overflow: u32, tiles: u32 }
struct Arguments { groups_x: u32, groups_y: u32, groups_z: u32 }
struct DrawArguments { indices: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32 }

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> temporary_tiles: array<Tile>;
@group(2) @binding(0) var<storage, read_write> dispatch: Arguments;
@group(2) @binding(1) var<storage, read_write> draw: DrawArguments;

@compute @workgroup_size(1)
fn prepare_root() {
    temporary_tiles[0] = Tile(0u, 0u, udlod.root_level);
    state = State(1u, 0u, 0u, 0u, 0u, 1u);
    dispatch = Arguments(1u, 1u, 1u);
}

@compute @workgroup_size(1)
fn prepare_next() {
    state.parents = state.children;
    state.children = 0u;
    state.backwards = 1u - state.backwards;
    dispatch = Arguments((state.parents + 63u) / 64u, 1u, 1u);
}

@compute @workgroup_size(1)
fn prepare_render() {
    draw = DrawArguments(6u * udlod.grid_size * udlod.grid_size, state.finals, 0u, 0u, 0u);
}
