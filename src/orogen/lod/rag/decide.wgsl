#include edges.wgsl
#include lists.wgsl
// The coarse mesh, what is dropped of it, and which edges are to be split.

// Column or row of a line of the coarse mesh. Cells are 2^cell_bits samples wide; what is left of the data after the
// last whole one is cut into cells whose widths are powers of two as well, so that halving always ends on samples.
fn coarse_line(n: u32, last: u32) -> u32 {
    let whole = last >> rag.cell_bits;
    if (n <= whole) { return n << rag.cell_bits; }
    var at = whole << rag.cell_bits;
    for (var k = whole; k < n; k += 1u) { at += 1u << firstLeadingBit(last - at); }
    return at;
}

// Both triangles of a cell of the coarse mesh, with heights that stay.
@compute @workgroup_size(GROUP)
fn place_coarse(@builtin(global_invocation_id) id: vec3<u32>) {
    let place = vec2<u32>(id.x % rag.cells.x, id.x / rag.cells.x);
    if (place.y >= rag.cells.y) { return; }
    var corners: array<Vertex, 4>;
    for (var n = 0u; n < 4u; n += 1u) {
        let sample = vec2<u32>(coarse_line(place.x + n % 2u, rag.last.x), coarse_line(place.y + n / 2u, rag.last.y));
        corners[n] = fetched(frame.extent.xy + vec2<i32>(sample << vec2<u32>(frame.subtexel_bits)));
    }
    triangles[2u * id.x] = Triangle(array<Vertex, 3>(corners[0], corners[2], corners[1]), 0u);
    triangles[2u * id.x + 1u] = Triangle(array<Vertex, 3>(corners[3], corners[1], corners[2]), 0u);
}

// Whether everything drawn over a triangle lies outside one of the frustum's planes. That its corners lie outside of
// some (section 4.4) would not do: it may be seen in part.
fn is_invisible(t: Triangle) -> bool {
    // before the first data has come there is nothing to draw
    if (clipmap.layers[HEIGHTS].present == 0u) { return true; }
    let cells = array<vec2<i32>, 3>(cell_of(t.corners[0]), cell_of(t.corners[1]), cell_of(t.corners[2]));
    let low = min(min(cells[0], cells[1]), cells[2]);
    let high = max(max(cells[0], cells[1]), cells[2]);
    let side = u32(max(high.x - low.x, high.y - low.y));
    let bits = i32(32u - countLeadingZeros(side));
    let bounds = bounds_over(low, high, u32(max(0, bits - i32(frame.subtexel_bits + NODE_BITS))));
    let a = to_metres(vec2<f32>(cells[0] - rag.anchor) - rag.offset);
    let b = to_metres(vec2<f32>(cells[1] - rag.anchor) - rag.offset);
    let c = to_metres(vec2<f32>(cells[2] - rag.anchor) - rag.offset);
    let far = max(max(dot(a, a), dot(b, b)), dot(c, c));
    let bottom = (bounds.x - rag.eye_height) * frame.exaggeration - frame.curvature * far;
    let top = (bounds.y - rag.eye_height) * frame.exaggeration;
    let distance = sqrt(far) + abs(bottom) + abs(top);
    // samples of a picture are up to half a pixel aside; rounding far away must not drop what touches a plane
    let slack = (rag.margin.x + 1e-6) * distance + rag.margin.y;
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = rag.planes[i];
        let flat = max(max(dot(plane.xy, a), dot(plane.xy, b)), dot(plane.xy, c));
        if (flat + max(plane.z * bottom, plane.z * top) + plane.w < -slack) { return true; }
    }
    return false;
}

// What the triangle's own edges ask for. An edge that stays whole is not looked at again, nor are the parts of one that
// gets an invisible vertex (section 4.2.1).
@compute @workgroup_size(GROUP)
fn decide(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.count) { return; }
    var t = triangle(id.x);
    if (is_invisible(t)) {
        plans[id.x] = 0u;
        return;
    }
    var plan = SEEN | (t.settled << SETTLED);
    for (var edge = 0u; edge < 3u; edge += 1u) {
        if (((t.settled >> edge) & 1u) == 1u) { continue; }
        let decision = decide_on_edge(t.corners[(edge + 1u) % 3u], t.corners[(edge + 2u) % 3u]);
        if (decision.split) {
            plan |= (1u << edge) | (decision.place << (PLACE + 4u * edge));
        } else {
            plan |= 1u << (SETTLED + edge);
        }
    }
    plans[id.x] = plan;
}
