#include clipmap.wgsl
// Everything drawn over a part of the ground, as an upright prism, against the LOD camera's frustum.

// Lowest and highest drawn height (metres of the data) over a rectangle of subtexels, from nodes that it fits into.
fn bounds_around(low: vec2<i32>, high: vec2<i32>) -> vec2<f32> {
    let side = u32(max(high.x - low.x, high.y - low.y));
    let bits = i32(32u - countLeadingZeros(side));
    return bounds_over(low, high, u32(max(0, bits - i32(frame.subtexel_bits + NODE_BITS))));
}

// Whether the prism over four places (metres east and north of the camera; a triangle names one twice) between two
// heights lies outside one of the frustum's planes.
fn prism_outside(a: vec2<f32>, b: vec2<f32>, c: vec2<f32>, d: vec2<f32>, bounds: vec2<f32>) -> bool {
    let far = max(max(dot(a, a), dot(b, b)), max(dot(c, c), dot(d, d)));
    let bottom = (bounds.x - frame.eye_height) * frame.exaggeration - frame.curvature * far;
    let top = (bounds.y - frame.eye_height) * frame.exaggeration;
    // rounding of positions far from the anchor must not cull what touches a plane
    let slack = 1e-6 * (sqrt(far) + abs(bottom) + abs(top));
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let flat = max(max(dot(plane.xy, a), dot(plane.xy, b)), max(dot(plane.xy, c), dot(plane.xy, d)));
        if (flat + max(plane.z * bottom, plane.z * top) + plane.w < -slack) { return true; }
    }
    return false;
}

// The same over a rectangle of subtexels, with all that is drawn there.
fn rectangle_outside(low: vec2<i32>, high: vec2<i32>) -> bool {
    let a = to_metres(vec2<f32>(low - frame.anchor) - frame.eye_offset);
    let b = to_metres(vec2<f32>(high - frame.anchor) - frame.eye_offset);
    let c = to_metres(vec2<f32>(f32(low.x - frame.anchor.x), f32(high.y - frame.anchor.y)) - frame.eye_offset);
    return prism_outside(a, b, c, a + b - c, bounds_around(low, high));
}
