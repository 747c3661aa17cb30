#include tree.wgsl
// The sum reduction (Dupuy 2020), once a frame, and what happens between the dispatches.
//
// Sums of fewer than 256 bits are not stored but counted: a word holds 32. Only regions in which a bit has changed are
// added up again.

struct Groups { x: u32, y: u32, z: u32 }
struct Dispatches { leaves: Groups, work: Groups, regions: Groups }
struct DrawArguments { vertices: u32, instances: u32, first_vertex: u32, first_instance: u32 }

@group(2) @binding(0) var<storage, read_write> dispatches: Dispatches;
@group(2) @binding(1) var<storage, read_write> draw: DrawArguments;

var<workgroup> sums: array<u32, 256>;

fn groups_for(count: u32) -> Groups {
    let groups = (count + 63u) / 64u;
    return Groups(min(groups, GROUPS_A_ROW), (groups + GROUPS_A_ROW - 1u) / GROUPS_A_ROW, 1u);
}

@compute @workgroup_size(1)
fn begin() {
    state.leaves = atomicLoad(&tree[SUMS + 1u]);
    state.work = state.leaves;
    state.half = 0u;
    state.updates = 0u;
    state.settled = 0u;
    atomicStore(&state.refused, 0u);
    atomicStore(&state.regions, 0u);
    atomicStore(&state.drawn, 0u);
    dispatches.leaves = groups_for(state.leaves);
    dispatches.work = dispatches.leaves;
    dispatches.regions = Groups(0u, 1u, 1u);
}

// After an update: what it made is the next one's work.
@compute @workgroup_size(1)
fn next() {
    if (state.settled == 1u) { return; }
    state.leaves += atomicExchange(&state.divided, 0u) - atomicExchange(&state.joined, 0u);
    state.work = min(atomicExchange(&state.added, 0u), cbt.capacity);
    state.half = 1u - state.half;
    state.updates += 1u;
    state.settled = u32(state.work == 0u);
    dispatches.leaves = groups_for(state.leaves);
    dispatches.work = groups_for(state.work);
    dispatches.regions = Groups(atomicLoad(&state.regions), 1u, 1u);
}

// All sums of a region.
@compute @workgroup_size(256)
fn sum_regions(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let region = atomicLoad(&tree[REGION_LIST + group.x]);
    if (local == 0u) { atomicStore(&tree[TOUCHED + region], 0u); }
    let block = 256u * region + local;
    var sum = 0u;
    for (var k = 0u; k < 8u; k += 1u) { sum += countOneBits(atomicLoad(&tree[8u * block + k])); }
    sums[local] = sum;
    atomicStore(&tree[SUMS + BLOCKS + block], sum);
    for (var width = 128u; width > 0u; width /= 2u) {
        workgroupBarrier();
        let pair = sums[(2u * local) % 256u] + sums[(2u * local + 1u) % 256u];
        workgroupBarrier();
        if (local < width) {
            sums[local] = pair;
            atomicStore(&tree[SUMS + (REGIONS + region) * width + local], pair);
        }
    }
}

// The sums above the regions', by one workgroup, level by level.
@compute @workgroup_size(256)
fn sum_top(@builtin(local_invocation_index) local: u32) {
    for (var width = REGIONS / 2u; width > 0u; width /= 2u) {
        storageBarrier();
        for (var node = width + local; node < 2u * width; node += 256u) {
            let sum = atomicLoad(&tree[SUMS + 2u * node]) + atomicLoad(&tree[SUMS + 2u * node + 1u]);
            atomicStore(&tree[SUMS + node], sum);
        }
    }
}

@compute @workgroup_size(1)
fn finish() {
    state.unsettled += u32(state.settled == 0u || atomicLoad(&state.refused) > 0u);
    draw = DrawArguments(3u * atomicLoad(&state.drawn), 1u, 0u, 0u);
}
