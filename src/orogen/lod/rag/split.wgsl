#include edges.wgsl
#include lists.wgsl
// The eight patterns (Schmiade 2008, figure 13): how many triangles one becomes, and which.

@compute @workgroup_size(GROUP)
fn count_children(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var made = 0u;
    if (id.x < state.count && plans[id.x] != 0u) {
        let plan = plans[id.x];
        if (RIGHT_ANGLED && (plan & SPLIT) != 0u && (plan & 1u) == 0u) { plans[id.x] = plan | INVISIBLE | 1u; }
        made = 1u + countOneBits(plans[id.x] & SPLIT);
    }
    hand_on(group.x, thread, made, id.x < state.count);
}

fn triangle_of(a: Vertex, b: Vertex, c: Vertex, settled: u32) -> Triangle {
    return Triangle(array<Vertex, 3>(a, b, c), settled);
}

// The new vertices of the edges across from the three corners.
fn new_vertices(t: Triangle, plan: u32) -> array<Vertex, 3> {
    var corners = t.corners;
    var made: array<Vertex, 3>;
    for (var edge = 0u; edge < 3u; edge += 1u) {
        if (((plan >> edge) & 1u) == 0u) { continue; }
        let a = corners[(edge + 1u) % 3u];
        let b = corners[(edge + 2u) % 3u];
        if (edge == 0u && (plan & INVISIBLE) != 0u) {
            made[edge] = interpolated(a, b);
        } else {
            made[edge] = fetched(new_cell(a, b, (plan >> (PLACE + 4u * edge)) & 15u));
        }
    }
    return made;
}

// With a split longest edge a triangle is halved there, and the halves are halved again where their longest edges, its
// legs, are split. The right angle stays in front, and what was between the last two corners is cut in two.
fn write_halves(at: u32, corner: array<Vertex, 3>, added: array<Vertex, 3>, plan: u32) {
    let middle = added[0];
    // both parts of an edge that gets an invisible vertex stay whole for ever
    let halves = select(0u, 1u, (plan & INVISIBLE) != 0u);
    let whole = plan >> SETTLED;
    var n = at;
    if ((plan & 4u) != 0u) {
        put(n, triangle_of(added[2], middle, corner[0], 0u));
        put(n + 1u, triangle_of(added[2], corner[1], middle, halves));
        n += 2u;
    } else {
        put(n, triangle_of(middle, corner[0], corner[1], ((whole >> 2u) & 1u) | (halves << 1u)));
        n += 1u;
    }
    if ((plan & 2u) != 0u) {
        put(n, triangle_of(added[1], middle, corner[2], halves));
        put(n + 1u, triangle_of(added[1], corner[0], middle, 0u));
    } else {
        put(n, triangle_of(middle, corner[2], corner[0], ((whole >> 1u) & 1u) | (halves << 2u)));
    }
}

// The three patterns that make oblique triangles: the longest edge stays whole.
fn write_oblique(at: u32, corner: array<Vertex, 3>, added: array<Vertex, 3>, plan: u32) {
    let whole = plan >> SETTLED;
    switch (plan & SPLIT) {
        case 2u: {
            put(at, triangle_of(corner[0], corner[1], added[1], whole & 4u));
            put(at + 1u, triangle_of(added[1], corner[1], corner[2], whole & 1u));
        }
        case 4u: {
            put(at, triangle_of(corner[0], added[2], corner[2], whole & 2u));
            put(at + 1u, triangle_of(added[2], corner[1], corner[2], whole & 1u));
        }
        default: {
            put(at, triangle_of(corner[0], added[2], added[1], 0u));
            put(at + 1u, triangle_of(added[2], corner[1], corner[2], whole & 1u));
            put(at + 2u, triangle_of(added[1], added[2], corner[2], 0u));
        }
    }
}

@compute @workgroup_size(GROUP)
fn write_children(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var plan = 0u;
    if (id.x < state.count) { plan = plans[id.x]; }
    let made = select(0u, 1u + countOneBits(plan & SPLIT), plan != 0u);
    let at = sums[group.x] + running_sum(thread, made) - made;
    if (made == 0u) { return; }
    let t = triangle(id.x);
    let added = new_vertices(t, plan);
    if ((plan & SPLIT) == 0u) {
        put(at, triangle_of(t.corners[0], t.corners[1], t.corners[2], (plan >> SETTLED) & 7u));
    } else if ((plan & 1u) == 1u) {
        write_halves(at, t.corners, added, plan);
    } else {
        write_oblique(at, t.corners, added, plan);
    }
}
