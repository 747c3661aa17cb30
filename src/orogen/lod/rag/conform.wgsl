#include rag.wgsl
#include lists.wgsl
#include table.wgsl
// Forced splits, handed on to the neighbours: what section 6.1 hopes for. All edges of the list stand in a table by
// their middles, so that both triangles of an edge see its mark.

// Twice the middle, which is a whole number.
fn edge_place(t: Triangle, edge: u32) -> vec2<i32> {
    var corners = t.corners;
    return cell_of(corners[(edge + 1u) % 3u]) + cell_of(corners[(edge + 2u) % 3u]);
}

fn place_of(reference: u32) -> vec2<i32> { return edge_place(triangle(reference / 3u), reference % 3u); }

@compute @workgroup_size(GROUP)
fn mark_edges(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.count || plans[id.x] == 0u) { return; }
    let t = triangle(id.x);
    for (var edge = 0u; edge < 3u; edge += 1u) {
        let slot = slot_for(edge_place(t, edge), 3u * id.x + edge);
        if (((plans[id.x] >> edge) & 1u) == 1u) { atomicOr(&table[slot], MARK); }
    }
}

// A split leg forces the longest edge, which may be a leg of the neighbour, and so on to ever larger triangles.
@compute @workgroup_size(GROUP)
fn spread_marks(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.count || plans[id.x] == 0u) { return; }
    let t = triangle(id.x);
    if (((entry_of(edge_place(t, 1u)) | entry_of(edge_place(t, 2u))) & MARK) != 0u) {
        atomicOr(&table[slot_for(edge_place(t, 0u), 3u * id.x)], MARK);
    }
}

@compute @workgroup_size(GROUP)
fn count_conforming(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var made = 0u;
    if (id.x < state.count && plans[id.x] != 0u) {
        let t = triangle(id.x);
        var plan = plans[id.x];
        for (var edge = 0u; edge < 3u; edge += 1u) {
            if ((entry_of(edge_place(t, edge)) & MARK) != 0u) { plan |= 1u << edge; }
        }
        plans[id.x] = plan;
        made = 1u + countOneBits(plan & SPLIT);
    }
    hand_on(group.x, thread, made, id.x < state.count);
}
