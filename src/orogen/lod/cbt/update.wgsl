#include tree.wgsl
#include wish.wgsl
// The updates of a frame (Dupuy 2020). In the first one every leaf looks at itself, in parallel. Whether a node is
// wanted divided does not change within a frame: so the next ones look only at the leaves that the one before has made.

fn make_work(node: u32) {
    let place = atomicAdd(&state.added, 1u);
    if (place < cbt.capacity) {
        nodes[(1u - state.half) * cbt.capacity + place] = node;
    } else {
        atomicAdd(&state.refused, 1u);
    }
}

// A node to look at; 0 where there is none, because it is no leaf any more.
fn work_of(number: u32) -> u32 {
    if (number >= state.work) { return 0u; }
    let node = nodes[state.half * cbt.capacity + number];
    return select(0u, node, is_divided(node >> 1u) && !is_divided(node));
}

@compute @workgroup_size(64)
fn list_leaves(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let number = number_of(group, local);
    if (number < state.leaves) { nodes[number] = leaf_of(number); }
}

fn divide_one(node: u32) -> bool {
    if (!divide(node)) { return false; }
    atomicAdd(&state.divided, 1u);
    make_work(2u * node);
    make_work(2u * node + 1u);
    return true;
}

// Divide a leaf and all that has to be, so that no edge has a corner of a neighbour in its middle: the node across the
// longest edge, first made a leaf by dividing its parent, and so on. Whoever divides a node also sees to its neighbour.
fn divide_conforming(leaf: u32) {
    var node = leaf;
    loop {
        if (node == 1u || !divide_one(node)) { break; }
        let partner = partner_of(node);
        if (partner == 0u || !divide_one(partner)) { break; }
        node = partner >> 1u;
    }
}

// In a conforming tree no leaf becomes more than four in one update.
fn has_room() -> bool { return 4u * state.leaves <= cbt.capacity; }

@compute @workgroup_size(64)
fn split(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let leaf = work_of(number_of(group, local));
    if (leaf == 0u || !is_wanted_divided(leaf)) { return; }
    if (has_room()) {
        divide_conforming(leaf);
    } else {
        atomicAdd(&state.refused, 1u);
    }
}

fn join_one(node: u32) {
    if (join(node)) {
        atomicAdd(&state.joined, 1u);
        make_work(node);
    }
}

// The two nodes that share a longest edge become leaves again, where all their halves are leaves and neither is wanted
// divided.
@compute @workgroup_size(64)
fn merge(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let leaf = work_of(number_of(group, local));
    // among all leaves one of up to four does it for the others
    let is_first = state.updates == 0u;
    if (leaf < 4u || (is_first && (leaf & 1u) == 1u) || is_divided(leaf ^ 1u)) { return; }
    let node = leaf >> 1u;
    let partner = partner_of(node);
    if (partner != 0u) {
        if (is_first && partner < node) { return; }
        if (is_divided(2u * partner) || is_divided(2u * partner + 1u) || is_wanted_divided(partner)) { return; }
    }
    if (is_wanted_divided(node)) { return; }
    if (partner != 0u) { join_one(partner); }
    join_one(node);
}
