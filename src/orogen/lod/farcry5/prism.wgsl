#include clipmap.wgsl
// What a rectangle of ground may hold: a prism over it, from its lowest to its highest drawn height.

struct Prism {
    low: vec2<i32>,          // subtexels
    high: vec2<i32>,
    bottom: f32,             // camera-relative metres
    top: f32,
}

fn corner_metres(cell: vec2<i32>) -> vec2<f32> {
    return to_metres(vec2<f32>(cell - frame.anchor) - frame.eye_offset);
}

fn prism_over(low: vec2<i32>, high: vec2<i32>) -> Prism {
    let side = u32(max(high.x - low.x, high.y - low.y));
    let node_level = u32(max(0, i32(32u - countLeadingZeros(side)) - i32(frame.subtexel_bits + NODE_BITS)));
    let bounds = clamp(bounds_over(low, high, node_level), vec2<f32>(frame.height_min), vec2<f32>(frame.height_max));
    let a = corner_metres(low);
    let b = corner_metres(vec2<i32>(high.x, low.y));
    let c = corner_metres(high);
    let d = corner_metres(vec2<i32>(low.x, high.y));
    let far = max(max(dot(a, a), dot(b, b)), max(dot(c, c), dot(d, d)));
    let bottom = (bounds.x - frame.eye_height) * frame.exaggeration - frame.curvature * far;
    let top = (bounds.y - frame.eye_height) * frame.exaggeration;
    return Prism(low, high, bottom, top);
}

fn prism_outside_frustum(prism: Prism) -> bool {
    let a = corner_metres(prism.low);
    let b = corner_metres(vec2<i32>(prism.high.x, prism.low.y));
    let c = corner_metres(prism.high);
    let d = corner_metres(vec2<i32>(prism.low.x, prism.high.y));
    let far = max(max(dot(a, a), dot(b, b)), max(dot(c, c), dot(d, d)));
    // rounding of positions far from the anchor must not cull what touches a plane
    let slack = 1e-6 * (sqrt(far) + abs(prism.bottom) + abs(prism.top));
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let flat = max(max(dot(plane.xy, a), dot(plane.xy, b)), max(dot(plane.xy, c), dot(plane.xy, d)));
        if (flat + max(plane.z * prism.bottom, plane.z * prism.top) + plane.w < -slack) { return true; }
    }
    return false;
}

fn distance_to_edge(p: vec2<f32>, a: vec2<f32>, b: vec2<f32>) -> f32 {
    let along = b - a;
    let way = clamp(dot(p - a, along) / max(dot(along, along), 1e-30), 0.0, 1.0);
    return distance(p, a + way * along);
}

// Horizontal distance of the LOD eye to a rectangle of subtexels, which need not be one in metres; 0 over it.
fn flat_distance(low: vec2<i32>, high: vec2<i32>) -> f32 {
    let eye = to_subtexels(frame.lod_eye.xy) + frame.eye_offset;
    if (all(eye >= vec2<f32>(low - frame.anchor)) && all(eye <= vec2<f32>(high - frame.anchor))) { return 0.0; }
    let a = corner_metres(low);
    let b = corner_metres(vec2<i32>(high.x, low.y));
    let c = corner_metres(high);
    let d = corner_metres(vec2<i32>(low.x, high.y));
    let p = frame.lod_eye.xy;
    return min(min(distance_to_edge(p, a, b), distance_to_edge(p, b, c)),
               min(distance_to_edge(p, c, d), distance_to_edge(p, d, a)));
}

// Distance of the LOD eye to the nearest point of a prism.
fn distance_to(prism: Prism) -> f32 {
    let above = max(max(frame.lod_eye.z - prism.top, prism.bottom - frame.lod_eye.z), 0.0);
    return length(vec2<f32>(flat_distance(prism.low, prism.high), above));
}
