#include lod/tiles.wgsl
#include counts.wgsl
// Between the passes: arguments of what comes next.

const GROUP = 64u;
const MARK_COLUMNS = 1024u;

struct State { indices: u32, finals: u32 }
struct Groups { x: u32, y: u32, z: u32, padding: u32 }

// At 0 bytes for choose.wgsl, at 16 for mark.wgsl, at 32 for the draw.
struct Arguments {
    choose: Groups,
    mark: Groups,
    indices: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32,
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(2) @binding(0) var<storage, read_write> arguments: Arguments;
@group(2) @binding(1) var<storage, read_write> counts: Counts;

// After the last level of refinement.
@compute @workgroup_size(1)
fn prepare_choice() {
    counts = Counts(state.finals, 0u, 0u, 0u);
    arguments.choose = Groups((state.finals + GROUP - 1u) / GROUP, 1u, 1u, 0u);
}

// After the choice.
@compute @workgroup_size(1)
fn prepare_draws() {
    arguments.mark = Groups(min(counts.rays, MARK_COLUMNS), (counts.rays + MARK_COLUMNS - 1u) / MARK_COLUMNS, 1u, 0u);
    arguments.indices = 6u * tiling.grid_size * tiling.grid_size;
    arguments.instances = counts.triangles;
    arguments.first_index = 0u;
    arguments.base_vertex = 0u;
    arguments.first_instance = 0u;
}
