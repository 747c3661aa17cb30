#include rag.wgsl
#include sums.wgsl
// Between the passes: sums over all triangles, room for them, and the arguments of dispatches and of the draw.

struct DrawArguments { vertices: u32, instances: u32, first_vertex: u32, first_instance: u32 }

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> sums: array<u32>;
@group(1) @binding(3) var<storage, read_write> dispatches: array<u32, 6>;   // over the list, and to write the next one
@group(1) @binding(4) var<storage, read_write> draw: DrawArguments;

var<workgroup> changed: atomic<u32>;
var<workgroup> groups: u32;

fn set_dispatch(number: u32, triangles: u32) {
    dispatches[3u * number] = (triangles + GROUP - 1u) / GROUP;
    dispatches[3u * number + 1u] = 1u;
    dispatches[3u * number + 2u] = 1u;
}

@compute @workgroup_size(1)
fn begin() {
    let count = 2u * rag.cells.x * rag.cells.y;
    state = State(count, 0u, 0u, 0u, 0u, 0u);
    set_dispatch(0u, count);
}

// Where each group's triangles begin in the next list (an exclusive sum in place), and how many there are.
@compute @workgroup_size(GROUP)
fn add_up(@builtin(local_invocation_index) thread: u32) {
    if (thread == 0u) {
        // none where the list was left as it is before
        groups = dispatches[0];
        // not every driver begins with zeros
        atomicStore(&changed, 0u);
    }
    let count = workgroupUniformLoad(&groups);
    var before = 0u;
    for (var first = 0u; first < count; first += GROUP) {
        var own = 0u;
        if (first + thread < count) { own = sums[first + thread]; }
        if ((own & CHANGED) != 0u) { atomicStore(&changed, 1u); }
        own &= ~CHANGED;
        let sum = running_sum(thread, own);
        if (first + thread < count) { sums[first + thread] = before + sum - own; }
        before += shared_sums[GROUP - 1u];
        workgroupBarrier();
    }
    if (thread != 0u) { return; }
    // without room for all, the list stays as it is: coarse is better than a hole, until it has grown
    if (before > rag.capacity) { state.needed = before; }
    // empty lists are written, too
    let written = atomicLoad(&changed) == 1u && before <= rag.capacity;
    state.next = select(0u, before + 1u, written);
    set_dispatch(1u, select(0u, state.count, written));
}

// The next list takes the place of this one.
@compute @workgroup_size(1)
fn turn() {
    if (state.next != 0u) {
        state.count = state.next - 1u;
        state.half = 1u - state.half;
    }
    // an unchanged list would stay so
    set_dispatch(0u, select(0u, state.count, state.next != 0u));
}

// All passes are done, or as many as this frame has time for.
@compute @workgroup_size(1)
fn end() {
    set_dispatch(0u, state.count);
    state.drawn = state.count;
    state.drawn_half = state.half;
    draw = DrawArguments(3u * state.count, 1u, 0u, 0u);
}

// What `weld` wrote is drawn, but not refined any further.
@compute @workgroup_size(1)
fn end_weld() {
    if (state.next == 0u) { return; }
    state.drawn = state.next - 1u;
    state.drawn_half = 1u - state.half;
    draw.vertices = 3u * state.drawn;
}
