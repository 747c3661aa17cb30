// Which nodes are wanted divided, and which are seen.
//
// A node that is wanted divided has a parent that is, too, exactly as computed: rectangles of subtexels nest, distances
// have a wide margin, all that follows from rectangles is monotonic in them, rounding included, and an error counts only
// where those of all that the node is a part of do. So the smallest conforming tree in which all wishes are met is
// unique, whatever the tree was before.

struct Box { low: vec2<i32>, high: vec2<i32> }

fn box_of(t: Triangle) -> Box {
    let low = frame.extent.xy + min(t.apex, min(t.first, t.last));
    let high = frame.extent.xy + max(t.apex, max(t.first, t.last));
    return Box(low, min(high, frame.extent.zw));
}

fn is_outside(box: Box) -> bool { return any(box.low >= frame.extent.zw); }

// The level whose nodes are at least as wide as the box.
fn level_of(box: Box) -> u32 {
    let side = u32(max(box.high.x - box.low.x, box.high.y - box.low.y));
    return u32(max(0, i32(32u - countLeadingZeros(side)) - i32(frame.subtexel_bits + NODE_BITS)));
}

// Lowest and highest height of a box that no part of it exceeds: what its levels have in common.
fn nested_bounds(box: Box) -> vec2<f32> {
    var bounds = vec2<f32>(-1e30, 1e30);
    let last = clipmap.layers[HEIGHTS].level_count - 1u;
    for (var level = min(level_of(box), last); level <= last; level += 1u) {
        let found = bounds_over(box.low, box.high, level);
        bounds = vec2<f32>(max(bounds.x, found.x), min(bounds.y, found.y));
    }
    return bounds;
}

// Whether a box with these lowest and highest heights touches the frustum.
fn in_frustum(box: Box, bounds: vec2<f32>) -> bool {
    let low = vec2<f32>(box.low - frame.anchor) - frame.eye_offset;
    let high = vec2<f32>(box.high - frame.anchor) - frame.eye_offset;
    let reach = max(abs(low), abs(high));
    let away = vec2<f32>(dot(abs(frame.metres.xy), reach), dot(abs(frame.metres.zw), reach));
    let drop = frame.curvature * dot(away, away);
    let bottom = (bounds.x - frame.eye_height) * frame.exaggeration - drop;
    let top = (bounds.y - frame.eye_height) * frame.exaggeration;
    // rounding of positions far from the anchor must not cull what touches a plane
    let tall = max(abs(frame.height_min - frame.eye_height), abs(frame.height_max - frame.eye_height));
    let slack = 1e-6 * (away.x + away.y + tall * frame.exaggeration + drop);
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = cbt.planes[i];
        let along = vec2<f32>(dot(plane.xy, frame.metres.xz), dot(plane.xy, frame.metres.yw));
        let flat = max(along.x * low.x, along.x * high.x) + max(along.y * low.y, along.y * high.y);
        if (flat + max(plane.z * bottom, plane.z * top) + plane.w < -slack) { return false; }
    }
    return true;
}

fn is_seen(node: u32) -> bool {
    // before the first data has come there is nothing to draw
    if (clipmap.layers[HEIGHTS].present == 0u) { return false; }
    let box = box_of(triangle_of(node));
    return !is_outside(box) && in_frustum(box, bounds_over(box.low, box.high, level_of(box)));
}

// Longest edges become shorter by the root of two from depth to depth.
fn reach_at(depth: u32) -> f32 {
    let steps = depth - 1u;
    return cbt.reach * inverse_power(steps / 2u) * select(1.0, 0.70710678, steps % 2u == 1u);
}

fn middle_of(t: Triangle) -> Point {
    return clamp_to_extent(Point(frame.extent.xy + (t.first + t.last) / 2, vec2<f32>(0.0)));
}

// Whether the longest edge covers more pixels than an undivided one may (Houska 2019, equation 2.3).
fn is_long(t: Triangle, depth: u32) -> bool { return lod_distance(flat_position(middle_of(t))) < reach_at(depth); }

fn corner_of(at: vec2<i32>) -> vec2<i32> { return clamp_to_extent(Point(frame.extent.xy + at, vec2<f32>(0.0))).cell; }

// Camera-relative height of the ground in metres.
fn ground_at(p: Point) -> f32 { return lift(flat_position(p), height_at(p)).z; }

// Whether the triangle as it is drawn leaves the ground by more than an undivided one may, at any of seven samples:
// three on the longest edge, which it shares, the middles of its legs, and two inside.
fn is_rough(t: Triangle) -> bool {
    let a = corner_of(t.apex);
    let b = corner_of(t.first);
    let c = corner_of(t.last);
    let corners = vec3<f32>(
        ground_at(Point(a, vec2<f32>(0.0))), ground_at(Point(b, vec2<f32>(0.0))), ground_at(Point(c, vec2<f32>(0.0))));
    let allowed = lod_distance(flat_position(middle_of(t))) / cbt.error_reach;
    // eighths of the corners
    var weights = array<vec3<i32>, 7>(
        vec3<i32>(0, 4, 4), vec3<i32>(0, 6, 2), vec3<i32>(0, 2, 6), vec3<i32>(4, 4, 0), vec3<i32>(4, 0, 4),
        vec3<i32>(4, 3, 1), vec3<i32>(4, 1, 3));
    for (var k = 0u; k < 7u; k += 1u) {
        let w = weights[k];
        // exact, and small enough for integers
        let eighths = w.x * (a & vec2<i32>(7)) + w.y * (b & vec2<i32>(7)) + w.z * (c & vec2<i32>(7));
        let cell = w.x * (a >> vec2<u32>(3u)) + w.y * (b >> vec2<u32>(3u)) + w.z * (c >> vec2<u32>(3u));
        let p = Point(cell + (eighths >> vec2<u32>(3u)), vec2<f32>(eighths & vec2<i32>(7)) / 8.0);
        if (abs(ground_at(p) - dot(vec3<f32>(w), corners) / 8.0) > allowed) { return true; }
    }
    return false;
}

// Whether all that a node is a part of is long or rough: samples of a half may find what its parent's miss, and a wish
// has to imply the parent's.
fn is_part_of_rough(node: u32) -> bool {
    let depth = depth_of_node(node);
    var t = outermost(node);
    for (var d = 1u; d < depth; d += 1u) {
        if (!is_long(t, d) && !is_rough(t)) { return false; }
        t = half_of_triangle(t, (node >> (depth - d - 1u)) & 1u);
    }
    return true;
}

// Whether a node in sight is to be divided.
fn is_wanted_divided(node: u32) -> bool {
    let depth = depth_of_node(node);
    if (depth >= cbt.finest || clipmap.layers[HEIGHTS].present == 0u) { return false; }
    let t = triangle_of(node);
    let box = box_of(t);
    if (is_outside(box)) { return false; }
    let long = is_long(t, depth);
    if (!long && cbt.error_reach == 0.0) { return false; }
    if (!in_frustum(box, nested_bounds(box))) { return false; }
    return long || (is_rough(t) && is_part_of_rough(node));
}
