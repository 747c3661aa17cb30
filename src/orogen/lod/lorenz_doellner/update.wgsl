#include mesh.wgsl
#include state.wgsl
// Pass 2, intermediate mesh update: the triangles of the last mesh are what the next one is made from. Each writes up
// to RATIO triangles of its coarse triangle's pattern, so that a mesh which lacks more than that takes several copies.

const RATIO = #{RATIO}u;
const BLOCKS = (COARSE + GROUP - 1u) / GROUP;

@group(0) @binding(0) var<storage, read_write> state: State;
@group(0) @binding(1) var<storage, read_write> coarse: array<Coarse>;
@group(0) @binding(2) var<storage, read_write> blocks: array<Block>;
@group(0) @binding(3) var<storage, read> pattern_table: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> pattern_triangles: array<array<u32, 3>>;
@group(0) @binding(5) var<storage, read_write> mesh: array<SubTriangle>;   // two halves, source and target by turns

struct Groups { x: u32, y: u32, z: u32 }
struct Dispatches { grow: Groups, copy: Groups }
@group(1) @binding(0) var<storage, read_write> dispatches: Dispatches;

fn capacity() -> u32 { return arrayLength(&mesh) / 2u; }

// Without room for all that is asked for, all edges alike do with fewer halvings: coarser, but without a gap.
@compute @workgroup_size(1)
fn begin_update() {
    var bias = 0u;
    while (bias < DEPTH && atomicLoad(&state.totals[bias]) > capacity()) { bias += 1u; }
    state.bias = bias;
    state.updates = 0u;
    state.running = 1u;
    atomicStore(&state.lacking, 0u);
    dispatches.grow = Groups(BLOCKS, 1u, 1u);
}

var<workgroup> sums: array<u32, GROUP>;

// Running sum over the workgroup, this thread's own number included.
fn sum_up_to(thread: u32, number: u32) -> u32 {
    sums[thread] = number;
    for (var reach = 1u; reach < GROUP; reach *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if (thread >= reach) { before = sums[thread - reach]; }
        workgroupBarrier();
        sums[thread] += before;
    }
    workgroupBarrier();
    return sums[thread];
}

// How far each pattern can be copied this time, and where it goes within its block.
@compute @workgroup_size(#{GROUP})
fn grow_patterns(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32,
                 @builtin(workgroup_id) block: vec3<u32>) {
    var count = 0u;
    if (id.x < COARSE) {
        let previous = coarse[id.x].available;
        let required = pattern_table[pattern_number(coarse[id.x].depths, state.bias)].y;
        count = min(required, previous * RATIO);
        coarse[id.x].previous = previous;
        coarse[id.x].available = count;
        if (count < required) { atomicAdd(&state.lacking, 1u); }
    }
    let end = sum_up_to(thread, count);
    if (id.x < COARSE) { coarse[id.x].base = end - count; }
    if (thread == GROUP - 1u) { blocks[block.x].count = end; }
}

// Where each block goes, and whether there is anything to do at all.
@compute @workgroup_size(#{GROUP})
fn place_blocks(@builtin(local_invocation_index) thread: u32) {
    let each = (BLOCKS + GROUP - 1u) / GROUP;
    let first = min(thread * each, BLOCKS);
    let last = min(first + each, BLOCKS);
    var count = 0u;
    for (var i = first; i < last; i += 1u) { count += blocks[i].count; }
    let end = sum_up_to(thread, count);
    var at = end - count;
    for (var i = first; i < last; i += 1u) {
        blocks[i].first = at;
        at += blocks[i].count;
    }
    if (thread < GROUP - 1u) { return; }
    dispatches.copy = Groups(0u, 1u, 1u);
    if (state.running == 1u) {
        state.source = state.count;
        state.count = end;
        state.half = 1u - state.half;
        state.updates += 1u;
        state.running = min(atomicExchange(&state.lacking, 0u), 1u);
        state.vertices = 3u * end * state.present;
        state.instances = 1u;
        dispatches.copy.x = (state.source + GROUP - 1u) / GROUP;
    }
    dispatches.grow.x = state.running * BLOCKS;
}

// Every so many triangles of the pattern are this source triangle's to write.
@compute @workgroup_size(#{GROUP})
fn copy_patterns(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.source) { return; }
    let key = mesh[(1u - state.half) * capacity() + id.x].key;
    let number = key >> NUMBER_BITS;
    let copied = coarse[number];
    let first = pattern_table[pattern_number(copied.depths, state.bias)].x;
    let target_first = state.half * capacity() + blocks[number / GROUP].first + copied.base;
    for (var i = key & ((1u << NUMBER_BITS) - 1u); i < copied.available; i += copied.previous) {
        mesh[target_first + i] = SubTriangle(pattern_triangles[first + i], number << NUMBER_BITS | i);
    }
}
