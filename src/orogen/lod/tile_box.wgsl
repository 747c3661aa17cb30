#include frustum.wgsl
// The box around all that may be drawn over a rectangle of subtexels, and whether there is anything. Low boxes are culled
// more often: their lids come from the maximum pyramids of the nodes that heights are taken from.

const MOST_TEXELS = 24;     // along a side that are looked through one by one

// Distances of the LOD eye to the nearest and the farthest point of a rectangle.
struct Reach { nearest: f32, farthest: f32 }

struct Box { low: vec3<f32>, high: vec3<f32> }    // camera-relative metres

fn nearest_on_edge(p: vec2<f32>, a: vec2<f32>, b: vec2<f32>) -> f32 {
    let along = b - a;
    let way = clamp(dot(p - a, along) / max(dot(along, along), 1e-30), 0.0, 1.0);
    return lod_distance(a + way * along);
}

// The rectangle need not be one in metres.
fn reach_of(low: vec2<i32>, high: vec2<i32>) -> Reach {
    let l = vec2<f32>(low - frame.anchor) - frame.eye_offset;
    let h = vec2<f32>(high - frame.anchor) - frame.eye_offset;
    let a = to_metres(l);
    let b = to_metres(vec2<f32>(h.x, l.y));
    let c = to_metres(h);
    let d = to_metres(vec2<f32>(l.x, h.y));
    let farthest = max(max(lod_distance(a), lod_distance(b)), max(lod_distance(c), lod_distance(d)));
    let eye = to_subtexels(frame.lod_eye.xy);
    if (all(eye >= l) && all(eye <= h)) { return Reach(lod_distance(frame.lod_eye.xy), farthest); }
    let p = frame.lod_eye.xy;
    return Reach(min(min(nearest_on_edge(p, a, b), nearest_on_edge(p, b, c)),
                     min(nearest_on_edge(p, c, d), nearest_on_edge(p, d, a))), farthest);
}

// Levels of the data that heights over a rectangle come from, with room for rounding: they are blended with the next one
// near the end of a level's range.
fn levels_over(reach: Reach) -> vec2<u32> {
    let end = distance_level(HEIGHTS, reach.farthest * 1.0001);
    let blended = fract(end) > 0.9999 - clipmap.layers[HEIGHTS].blend_range;
    return vec2<u32>(u32(distance_level(HEIGHTS, reach.nearest * 0.9999)), u32(end) + select(0u, 1u, blended));
}

// The part of a rectangle that lies in a node of a level, and the node that its heights come from.
struct Part { node: Node, low: vec2<i32>, high: vec2<i32> }

fn part_of(low: vec2<i32>, high: vec2<i32>, node: vec2<i32>, level: u32) -> Part {
    let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + level);
    let first = max(low, node << shift);
    return Part(lookup(HEIGHTS, first, level), first, min(high, (node + 1) << shift));
}

// Highest sample that the heights of a part are interpolated from.
fn highest_in(part: Part) -> f32 {
    // cells lie between two samples each way
    let shift = vec2<u32>(frame.subtexel_bits + part.node.level);
    let half = 1i << (shift.x - 1u);
    let start = part.node.cell << vec2<u32>(NODE_BITS);
    let a = ((part.low + half) >> shift) - start;
    let b = ((part.high + half) >> shift) - start;
    var k = 1u;
    while (k < NODE_BITS && any((b >> vec2<u32>(k)) - (a >> vec2<u32>(k)) > vec2<i32>(1))) { k += 1u; }
    var highest = -1e30;
    for (var y = a.y >> k; y <= b.y >> k; y += 1) {
        for (var x = a.x >> k; x <= b.x >> k; x += 1) {
            highest = max(highest, maximum_texel(part.node.slot, k, vec2<i32>(x, y)));
        }
    }
    return highest;
}

// The same over a rectangle; 1e30 where that would take long to find.
fn highest_over(low: vec2<i32>, high: vec2<i32>, reach: Reach) -> f32 {
    let levels = levels_over(reach);
    if (levels.y > levels.x + 2u) { return 1e30; }
    var highest = frame.height_min;
    for (var level = levels.x; level <= levels.y; level += 1u) {
        let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + level);
        let a = low >> shift;
        let b = high >> shift;
        if (any(b - a > vec2<i32>(1))) { return 1e30; }
        for (var y = a.y; y <= b.y; y += 1) {
            for (var x = a.x; x <= b.x; x += 1) {
                let part = part_of(low, high, vec2<i32>(x, y), level);
                if (part.node.slot == NO_SLOT) { return 1e30; }
                highest = max(highest, highest_in(part));
            }
        }
    }
    return highest;
}

// `bounds`: lowest and highest height over the rectangle.
fn box_between(low: vec2<i32>, high: vec2<i32>, bounds: vec2<f32>) -> Box {
    let a = to_metres(vec2<f32>(low - frame.anchor) - frame.eye_offset);
    let b = to_metres(vec2<f32>(high - frame.anchor) - frame.eye_offset);
    let c = to_metres(vec2<f32>(f32(low.x - frame.anchor.x), f32(high.y - frame.anchor.y)) - frame.eye_offset);
    let d = a + b - c;
    let from_flat = min(min(a, b), min(c, d));
    let to_flat = max(max(a, b), max(c, d));
    // the ground is bent down with the distance: the floor as at the farthest, the lid as at the nearest point
    let far = max(abs(from_flat), abs(to_flat));
    let near = max(max(from_flat, -to_flat), vec2<f32>(0.0));
    let bottom = lift(far, bounds.x).z;
    let top = lift(near, bounds.y).z;
    let slack = vec3<f32>(1e-6) * (length(far) + abs(bottom) + abs(top));
    return Box(vec3<f32>(from_flat, bottom) - slack, vec3<f32>(to_flat, top) + slack);
}

// Bounds on the heights over a rectangle, close to what is drawn from above.
fn bounds_below(low: vec2<i32>, high: vec2<i32>, reach: Reach, bounds: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(bounds.x, min(bounds.y, highest_over(low, high, reach)));
}

// Whether a box lies outside one of the planes of the LOD camera's frustum.
fn box_outside(box: Box) -> bool {
    let slack = 1e-6 * length(max(abs(box.low), abs(box.high)));
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let corner = select(box.low, box.high, plane.xyz > vec3<f32>(0.0));
        if (dot(plane.xyz, corner) + plane.w < -slack) { return true; }
    }
    return false;
}

// Whether a box lies inside all of them.
fn box_inside(box: Box) -> bool {
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let corner = select(box.high, box.low, plane.xyz > vec3<f32>(0.0));
        if (dot(plane.xyz, corner) + plane.w < 0.0) { return false; }
    }
    return true;
}

// First and last texel of its node that the heights of a part are interpolated from; nothing where these are many.
fn texels_of(part: Part) -> vec4<i32> {
    let first = texel_of(Point(part.low, vec2<f32>(0.0)), part.node, frame.subtexel_bits).at;
    let last = texel_of(Point(part.high, vec2<f32>(0.0)), part.node, frame.subtexel_bits).at + 1;
    if (part.node.slot == NO_SLOT || any(last - first >= vec2<i32>(MOST_TEXELS))) { return vec4<i32>(0, 0, -1, -1); }
    return vec4<i32>(first, last);
}

// Lowest of these; -1e30 where they are many. Four at a time: each alone would be waited for.
fn lowest_in(part: Part) -> f32 {
    let texels = texels_of(part);
    if (texels.z < texels.x) { return -1e30; }
    var lowest = vec4<f32>(1e30);
    for (var y = texels.y; y <= texels.w; y += 1) {
        for (var x = texels.x; x <= texels.z; x += 4) {
            let columns = min(x + vec4<i32>(0, 1, 2, 3), vec4<i32>(texels.z));
            lowest = min(lowest, vec4<f32>(
                height_texel(part.node.slot, vec2<i32>(columns.x, y)), height_texel(part.node.slot, vec2<i32>(columns.y, y)),
                height_texel(part.node.slot, vec2<i32>(columns.z, y)), height_texel(part.node.slot, vec2<i32>(columns.w, y))));
        }
    }
    return min(min(lowest.x, lowest.y), min(lowest.z, lowest.w));
}

fn coverage_texel(slot: u32, x: i32, y: i32) -> f32 {
    return textureLoad(coverage_atlas, vec2<i32>(x, y) + HEIGHT_BORDER, i32(slot), 0).x;
}

// Whether any of these may be valid.
fn has_data(part: Part) -> bool {
    let texels = texels_of(part);
    if (texels.z < texels.x) { return true; }
    for (var y = texels.y; y <= texels.w; y += 1) {
        var valid = 0.0;
        for (var x = texels.x; x <= texels.z; x += 4) {
            let columns = min(x + vec4<i32>(0, 1, 2, 3), vec4<i32>(texels.z));
            valid += coverage_texel(part.node.slot, columns.x, y) + coverage_texel(part.node.slot, columns.y, y)
                   + coverage_texel(part.node.slot, columns.z, y) + coverage_texel(part.node.slot, columns.w, y);
        }
        if (valid > 0.0) { return true; }
    }
    return false;
}

// Whether nothing of a rectangle is drawn, by all its samples: for want of data, or because it lies outside the frustum
// with the lid of its box. Where that would take long to find out, it counts as drawn.
fn is_empty(low: vec2<i32>, high: vec2<i32>, reach: Reach, box: Box) -> bool {
    var seeks_data = !COVERED;
    let seeks_lowest = box_outside(Box(vec3<f32>(box.low.xy, box.high.z), box.high));
    var lowest = frame.height_max;
    let levels = levels_over(reach);
    for (var level = levels.x; level <= levels.y && (seeks_data || seeks_lowest); level += 1u) {
        let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + level);
        let a = low >> shift;
        let b = high >> shift;
        if (any(b - a > vec2<i32>(1))) { return false; }
        for (var y = a.y; y <= b.y; y += 1) {
            for (var x = a.x; x <= b.x; x += 1) {
                let part = part_of(low, high, vec2<i32>(x, y), level);
                if (seeks_data && has_data(part)) { seeks_data = false; }
                if (seeks_lowest) { lowest = min(lowest, lowest_in(part)); }
            }
        }
    }
    if (seeks_data) { return true; }
    if (!seeks_lowest) { return false; }
    let far = max(abs(box.low.xy), abs(box.high.xy));
    let bottom = lift(far, lowest).z;
    return box_outside(Box(vec3<f32>(box.low.xy, max(box.low.z, bottom - 1e-6 * (length(far) + abs(bottom)))), box.high));
}
