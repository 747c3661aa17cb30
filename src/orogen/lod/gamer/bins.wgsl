// Sorting coarse triangles by pattern, always in the same order: a prefix sum over the workgroups of each pattern, then
// over the patterns, then every triangle goes to its place.

const PATTERNS = #{PATTERNS}u;
const NONE = 0xffffffffu;

struct DrawArguments { indices: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32 }

@group(0) @binding(0) var<storage, read> choices: array<u32>;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;    // pattern by pattern; then sums of those before
@group(0) @binding(2) var<storage, read_write> starts: array<u32>;      // where each pattern's instances begin
@group(0) @binding(3) var<storage, read_write> draws: array<DrawArguments>;
@group(0) @binding(4) var<storage, read_write> instances: array<u32>;

var<workgroup> sums: array<u32, 64>;

@compute @workgroup_size(64)
fn sum_groups(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let pattern = group.x;
    let groups = arrayLength(&counts) / PATTERNS;
    let each = (groups + 63u) / 64u;
    let first = pattern * groups + min(thread * each, groups);
    let last = pattern * groups + min((thread + 1u) * each, groups);
    var sum = 0u;
    for (var i = first; i < last; i += 1u) { sum += counts[i]; }
    sums[thread] = sum;
    workgroupBarrier();
    var before = 0u;
    for (var i = 0u; i < thread; i += 1u) { before += sums[i]; }
    for (var i = first; i < last; i += 1u) {
        let count = counts[i];
        counts[i] = before;
        before += count;
    }
    if (thread == 63u) { draws[pattern].instances = before; }
}

@compute @workgroup_size(1)
fn sum_patterns() {
    var before = 0u;
    for (var i = 0u; i < PATTERNS; i += 1u) {
        starts[i] = before;
        before += draws[i].instances;
    }
}

var<workgroup> beside: array<u32, 128>;

@compute @workgroup_size(128)
fn place_triangles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let triangle = group.x * 128u + thread;
    let chosen = choices[triangle];
    let pattern = chosen >> 9u;
    beside[thread] = pattern;
    workgroupBarrier();
    if (chosen == NONE) { return; }
    let groups = arrayLength(&counts) / PATTERNS;
    var place = starts[pattern] + counts[pattern * groups + group.x];
    for (var i = 0u; i < thread; i += 1u) { place += u32(beside[i] == pattern); }
    instances[place] = triangle << 9u | (chosen & 511u);
}
