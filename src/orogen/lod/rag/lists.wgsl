#include sums.wgsl
// What the passes work on.

const SPLIT = 7u;              // of a plan: edges that get a vertex, a bit each
const SETTLED = 3u;            // first of the bits of edges that stay whole
const SEEN = 64u;              // the triangle is not dropped
const INVISIBLE = 128u;        // the vertex on the longest edge is interpolated
const PLACE = 8u;              // first of four bits for each edge: the sample that its vertex stands on

@group(1) @binding(1) var<storage, read_write> triangles: array<Triangle>;
@group(1) @binding(2) var<storage, read_write> plans: array<u32>;
@group(1) @binding(3) var<storage, read_write> sums: array<u32>;
@group(1) @binding(4) var<storage, read> state: State;

fn triangle(n: u32) -> Triangle { return triangles[state.half * rag.capacity + n]; }

fn put(n: u32, made: Triangle) { triangles[(1u - state.half) * rag.capacity + n] = made; }

// Hand the number of triangles that each thread's triangle becomes on to `add_up`.
fn hand_on(group: u32, thread: u32, made: u32, exists: bool) {
    let changed = running_sum(thread, select(0u, 0x10000u, exists && made != 1u));
    workgroupBarrier();
    let sum = running_sum(thread, made);
    if (thread == GROUP - 1u) { sums[group] = sum | select(0u, CHANGED, changed != 0u); }
}
