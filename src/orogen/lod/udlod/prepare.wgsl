#include lod/tiles.wgsl
// After the last level of refinement: the arguments of the draw.

struct State { parents: u32, progress: u32, finals: u32 }
struct DrawArguments { indices: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32 }

@group(1) @binding(1) var<storage, read_write> state: State;
@group(2) @binding(0) var<storage, read_write> draw: DrawArguments;

@compute @workgroup_size(1)
fn prepare_draw() {
    draw = DrawArguments(6u * tiling.grid_size * tiling.grid_size, state.finals, 0u, 0u, 0u);
}
