// Which nodes are wanted divided, and which are seen.
//
// A node that is wanted divided has a parent that is, too, exactly as computed: rectangles of subtexels nest, distances
// have a wide margin, and all that follows from rectangles is monotonic in them, rounding included. So the smallest
// conforming tree in which all wishes are met is unique, whatever the tree was before.

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

// Whether the longest edge of a node in sight covers more pixels than asked for (Houska 2019, equation 2.3).
fn is_wanted_divided(node: u32) -> bool {
    let depth = depth_of_node(node);
    if (depth >= cbt.finest || clipmap.layers[HEIGHTS].present == 0u) { return false; }
    let t = triangle_of(node);
    let box = box_of(t);
    if (is_outside(box)) { return false; }
    let middle = clamp_to_extent(Point(frame.extent.xy + (t.first + t.last) / 2, vec2<f32>(0.0)));
    if (lod_distance(flat_position(middle)) >= reach_at(depth)) { return false; }
    return in_frustum(box, nested_bounds(box));
}
