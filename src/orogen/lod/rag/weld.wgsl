#include rag.wgsl
#include lists.wgsl
#include table.wgsl
// Invisible vertices that are invisible to the last bit. A vertex interpolated on an edge is on it but for rounding, so
// a pixel may fall between. Therefore the triangle on the other side gets it, too: it becomes a fan of flat parts.

const DEEPEST = 32u;

// The vertices of the list stand in the table.
fn place_of(reference: u32) -> vec2<i32> {
    var corners = triangle(reference / 3u).corners;
    return cell_of(corners[reference % 3u]);
}

@compute @workgroup_size(GROUP)
fn enter_vertices(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.count) { return; }
    for (var k = 0u; k < 3u; k += 1u) {
        let reference = 3u * id.x + k;
        _ = slot_for(place_of(reference), reference);
    }
}

fn has_vertex(a: Vertex, b: Vertex) -> bool { return reach(a, b) > 1 && entry_of(middle_cell(a, b)) != 0u; }

// A walk along an edge, from vertex to vertex: `ends[left - 1]` comes next, unless there are vertices before it.
struct Walk { ends: array<Vertex, DEEPEST>, left: u32 }

fn walk_to(end: Vertex) -> Walk {
    var walk: Walk;
    walk.ends[0] = end;
    walk.left = 1u;
    return walk;
}

fn next_vertex(walk: ptr<function, Walk>, from_here: Vertex) -> Vertex {
    loop {
        let end = (*walk).ends[(*walk).left - 1u];
        if ((*walk).left == DEEPEST || !has_vertex(from_here, end)) { break; }
        (*walk).ends[(*walk).left] = interpolated(from_here, end);
        (*walk).left += 1u;
    }
    (*walk).left -= 1u;
    return (*walk).ends[(*walk).left];
}

// Parts that an edge has.
fn parts_of(a: Vertex, b: Vertex) -> u32 {
    var walk = walk_to(b);
    var parts = 0u;
    var here = a;
    while (walk.left > 0u) {
        here = next_vertex(&walk, here);
        parts += 1u;
    }
    return parts;
}

fn parts_of_edges(t: Triangle) -> vec3<u32> {
    var corners = t.corners;
    var parts: vec3<u32>;
    for (var edge = 0u; edge < 3u; edge += 1u) {
        parts[edge] = parts_of(corners[(edge + 1u) % 3u], corners[(edge + 2u) % 3u]);
    }
    return parts;
}

// One edge with vertices is seen from the corner across, more of them from inside.
fn fan_size(parts: vec3<u32>) -> u32 {
    let divided = vec3<u32>(parts > vec3<u32>(1u));
    if (divided.x + divided.y + divided.z <= 1u) { return max(max(parts.x, parts.y), parts.z); }
    return parts.x + parts.y + parts.z;
}

@compute @workgroup_size(GROUP)
fn count_fans(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var made = 0u;
    if (id.x < state.count) { made = fan_size(parts_of_edges(triangle(id.x))); }
    hand_on(group.x, thread, made, id.x < state.count);
}

// A point inside, on the triangle's plane.
fn inside(t: Triangle) -> Vertex {
    let a = t.corners[0];
    let along = cell_of(t.corners[1]) - cell_of(a);
    let across = cell_of(t.corners[2]) - cell_of(a);
    let cell = (along + across) / 3;
    let area = f32(along.x) * f32(across.y) - f32(along.y) * f32(across.x);
    let b_share = (f32(cell.x) * f32(across.y) - f32(cell.y) * f32(across.x)) / area;
    let c_share = (f32(along.x) * f32(cell.y) - f32(along.y) * f32(cell.x)) / area;
    let height = a.height + (t.corners[1].height - a.height) * b_share + (t.corners[2].height - a.height) * c_share;
    return Vertex(a.x + cell.x, a.y + cell.y, height);
}

@compute @workgroup_size(GROUP)
fn write_fans(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    var parts = vec3<u32>(0u);
    if (id.x < state.count) { parts = parts_of_edges(triangle(id.x)); }
    let made = fan_size(parts);
    var at = sums[group.x] + running_sum(thread, made) - made;
    if (id.x >= state.count) { return; }
    let t = triangle(id.x);
    if (made == 1u) {
        put(at, t);
        return;
    }
    var corners = t.corners;
    let central = made == parts.x + parts.y + parts.z;
    var apex = inside(t);
    for (var edge = 0u; edge < 3u; edge += 1u) {
        if (!central) {
            if (parts[edge] == 1u) { continue; }
            apex = corners[edge];
        }
        var here = corners[(edge + 1u) % 3u];
        var walk = walk_to(corners[(edge + 2u) % 3u]);
        while (walk.left > 0u) {
            let next = next_vertex(&walk, here);
            put(at, Triangle(array<Vertex, 3>(apex, here, next), 0u));
            here = next;
            at += 1u;
        }
    }
}
