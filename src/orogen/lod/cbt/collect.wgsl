#include tree.wgsl
#include wish.wgsl
// The list of leaves to draw: those in sight.

var<workgroup> count: atomic<u32>;
var<workgroup> first: u32;

@compute @workgroup_size(64)
fn collect(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    if (local == 0u) { atomicStore(&count, 0u); }
    workgroupBarrier();
    let number = number_of(group, local);
    var leaf = 0u;
    var place = 0u;
    if (number < state.leaves) {
        leaf = leaf_of(number);
        if (is_seen(leaf)) { place = atomicAdd(&count, 1u); } else { leaf = 0u; }
    }
    workgroupBarrier();
    if (local == 0u) { first = atomicAdd(&state.drawn, atomicLoad(&count)); }
    workgroupBarrier();
    if (leaf != 0u) { nodes[first + place] = leaf; }
}
