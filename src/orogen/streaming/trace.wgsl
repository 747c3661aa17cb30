#include clipmap.wgsl
#include maxima_layout.wgsl
// Rays against the resident height field: hierarchical traversal of maximum pyramids (Dick et al. 2009; Houska 2019,
// section 2.3.7) and exact intersection with the bilinear surface between sample centres.
//
// Watertight by construction: cells are stepped by integer index, only the axis that is crossed first moves, the other
// stays inside the block; and a ray that enters a cell on the other side of its surface has hit it at the entry, be it
// for rounding or because the neighbouring node is of another level.

struct Hit {
    found: bool,
    t: f32,              // along the ray, in units of its direction
    level: u32,          // of the node that was hit
    node: vec2<i32>,
    way: vec2<f32>,      // position in the cell that was hit, 0 to 1
}

const ANY_HIT = #{ANY_HIT};      // whether a ray hits anything is all that is asked
const STAYS_ABOVE = COVERED && ANY_HIT;

const CEILING_BLOCK = #{CEILING_BLOCK};   // cells along the side of a block that shares a sun ceiling
const CEILING_BITS = firstTrailingBit(u32(CEILING_BLOCK));

// Rays leave the loop over blocks where they come down to a cell, and ask the block around the next cell first: a software
// driver takes another turn of every loop for all lanes.
const EAGER = SOFTWARE && !ANY_HIT;
const START = 5u;                         // 2^START cells: the blocks that are asked first
const LEAST = select(0u, 1u, EAGER);

const UNKNOWN = 0;
const ABOVE = 1;
const BELOW = 2;
const SHADOW_MARGIN = 0.05;   // texels: shading is smoother than the cells, which shadow one another where light grazes
const STEPS = 1 << 17;   // more than cells on any path: ends rays that rounding has made endless

// Height of a ray over frame.eye_height, in metres of the data: x + t y + t^2 z (the last from the earth's curvature); w:
// the t of its lowest point, far away where it has none.
fn ray_height(ray: Ray) -> vec4<f32> {
    let o = ray.origin;
    let d = ray.direction;
    let z = vec3<f32>(
        o.z + frame.curvature * dot(o.xy, o.xy),
        d.z + 2.0 * frame.curvature * dot(o.xy, d.xy),
        frame.curvature * dot(d.xy, d.xy)) / frame.exaggeration + vec3<f32>(frame.eye_rest, 0.0, 0.0);
    let bottom = select(select(-1e30, 1e30, z.y < 0.0), -0.5 * z.y / z.z, z.z > 0.0);
    return vec4<f32>(z, bottom);
}

fn height_on(z: vec4<f32>, t: f32) -> f32 { return z.x + t * (z.y + t * z.z); }

// Lowest height of the ray between two parameters: the parabola is convex.
fn lowest_on(z: vec4<f32>, a: f32, b: f32) -> f32 {
    return height_on(z, clamp(z.w, a, b));
}

// Highest height of the ray between two parameters.
fn highest_on(z: vec4<f32>, a: f32, b: f32) -> f32 { return max(height_on(z, a), height_on(z, b)); }

// The level whose node around the cell the traversal uses: a node is split while its nearest point is in reach of finer
// data, so that all rays agree.
fn traversal_level(cell: vec2<i32>) -> u32 {
    let shift = frame.subtexel_bits + NODE_BITS;
    let eye = to_subtexels(frame.lod_eye.xy) + frame.eye_offset;
    let reach = 0.5 * clipmap.layers[HEIGHTS].reach;
    var level = u32(distance_level(HEIGHTS, lod_distance(to_metres(vec2<f32>(cell - frame.anchor) - frame.eye_offset))));
    loop {
        if (level == 0u) { break; }
        let low = (cell >> vec2<u32>(shift + level)) << vec2<u32>(shift + level);
        let corner = vec2<f32>(low - frame.anchor);
        let nearest = clamp(eye, corner, corner + f32(1u << (shift + level)));
        if (lod_distance(to_metres(nearest - frame.eye_offset)) >= reach * f32(1u << level)) { break; }
        level -= 1u;
    }
    return level;
}

// Part of the ray over the drawn area, x > y if none.
fn over_extent(o: vec2<f32>, d: vec2<f32>, from_t: f32, to_t: f32) -> vec2<f32> {
    var span = vec2<f32>(from_t, to_t);
    for (var axis = 0u; axis < 2u; axis += 1u) {
        let low = f32(frame.extent[axis] - frame.anchor[axis]) - o[axis];
        let high = f32(frame.extent[axis + 2u] - frame.anchor[axis]) - o[axis];
        if (d[axis] == 0.0) {
            if (low > 0.0 || high < 0.0) { return vec2<f32>(1.0, 0.0); }
        } else {
            let a = low / d[axis];
            let b = high / d[axis];
            span = vec2<f32>(max(span.x, min(a, b)), min(span.y, max(a, b)));
        }
    }
    return span;
}

// Part of the ray that is not above the highest sample, x > y if none.
fn under_ceiling(z: vec4<f32>, span: vec2<f32>) -> vec2<f32> {
    let ceiling = frame.height_max - frame.eye_height;
    // raised by more than the rounding of a ray's height
    let c = z.x - ceiling - 2e-6 * (abs(z.x) + abs(ceiling));
    if (z.z > 1e-30) {
        let root = z.y * z.y - 4.0 * z.z * c;
        if (root < 0.0) { return vec2<f32>(1.0, 0.0); }
        let q = -0.5 * (z.y + select(-1.0, 1.0, z.y >= 0.0) * sqrt(root));
        if (q == 0.0) { return span; }
        let a = q / z.z;
        let b = c / q;
        return vec2<f32>(max(span.x, min(a, b)), min(span.y, max(a, b)));
    }
    if (z.y < 0.0) { return vec2<f32>(max(span.x, -c / z.y), span.y); }
    if (z.y > 0.0) { return vec2<f32>(span.x, min(span.y, -c / z.y)); }
    return select(span, vec2<f32>(1.0, 0.0), c > 0.0);
}

// A ray in a node's cells, column and row: at from + t * way. Borders are met at border * pace + start.
struct Path { start: vec2<f32>, pace: vec2<f32>, origin: vec2<f32>, way: vec2<f32>, forwards: vec2<bool> }

// `corner`: subtexels from the anchor of the node's first cell, which are 2^shift wide.
fn path_of(o: vec2<f32>, d: vec2<f32>, corner: vec2<f32>, shift: u32) -> Path {
    let moves = d != vec2<f32>(0.0);
    let inverse = select(vec2<f32>(0.0), 1.0 / d, moves);
    let start = select(vec2<f32>(1e30), (corner - o) * inverse, moves);
    let scale = inverse_power(shift);
    return Path(start, inverse * f32(1u << shift), (o - corner) * scale, d * scale, d >= vec2<f32>(0.0));
}

// Where a ray leaves a block of 2^k cells: its parameter, and the axis whose border it meets.
struct Crossing { t: f32, axis: u32 }

fn crossing_of(c: vec2<i32>, k: u32, path: Path) -> Crossing {
    let low = (c >> vec2<u32>(k)) << vec2<u32>(k);
    let exits = fma(vec2<f32>(select(low, low + (1i << k), path.forwards)), path.pace, path.start);
    return Crossing(min(exits.x, exits.y), select(1u, 0u, exits.x <= exits.y));
}

// The cell behind a block's border: the crossed axis moves by index, the other one stays in the block.
fn next_cell(c: vec2<i32>, k: u32, crossing: Crossing, t: f32, path: Path) -> vec2<i32> {
    let low = (c >> vec2<u32>(k)) << vec2<u32>(k);
    let high = low + (1i << k);
    let there = vec2<i32>(floor(fma(path.way, vec2<f32>(t), path.origin)));
    let inside = clamp(there, select(low, c, path.forwards), select(c, high - 1, path.forwards));
    let beyond = select(low - 1, high, path.forwards);
    return select(inside, beyond, vec2<bool>(crossing.axis == 0u, crossing.axis == 1u));
}

// Height over which a ray towards the sun, above the surface in a cell of a node, leaves the node above it.
fn ceiling_over(slot: u32, c: vec2<i32>) -> f32 {
    return textureLoad(ceilings_atlas, c / CEILING_BLOCK, i32(slot), 0).x - frame.eye_height;
}

// First point between `from_t` and `to_t` where the ray meets the surface from above, or from below where
// `from_below` is set and the ray has come under it (through missing data, or from the edge). A ray without `from_below`
// starts above the surface.
fn trace(ray: Ray, from_t: f32, to_t: f32, from_below: bool) -> Hit {
    var miss: Hit;
    if (clipmap.layers[HEIGHTS].present == 0u) { return miss; }
    let o = to_subtexels(ray.origin.xy) + frame.eye_offset;
    let d = to_subtexels(ray.direction.xy);
    let z = ray_height(ray);
    let over = over_extent(o, d, from_t, to_t);
    let span = under_ceiling(z, over);
    if (!(over.x <= over.y) || !(span.x <= span.y)) { return miss; }

    let forwards = d >= vec2<f32>(0.0);
    var t = span.x;
    var cell = clamp(frame.anchor + vec2<i32>(floor(o + t * d)), frame.extent.xy, frame.extent.zw - 1);
    var side = select(UNKNOWN, ABOVE, span.x > over.x || !from_below);
    var steps = 0;
    loop {
        // one node
        let level = traversal_level(cell);
        let node = lookup(HEIGHTS, cell, level);
        let range = texel_range(cell, node);
        let node_shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + node.asked);
        let node_low = max((cell >> node_shift) << node_shift, frame.extent.xy);
        let node_high = min(((cell >> node_shift) + 1) << node_shift, frame.extent.zw);
        let node_way = (vec2<f32>(select(node_low, node_high, forwards) - frame.anchor) - o) / d;
        let node_exits = select(vec2<f32>(1e30), node_way, d != vec2<f32>(0.0));
        let node_end = clamp(min(node_exits.x, node_exits.y), t, span.y);

        let above = side != BELOW && lowest_on(z, t, node_end) > range.y - frame.eye_height;
        let under = !STAYS_ABOVE && side != ABOVE && highest_on(z, t, node_end) < range.x - frame.eye_height;
        if (node.slot == NO_SLOT || above) {
            side = ABOVE;
        } else if (under) {
            side = BELOW;
        } else {
            let shift = frame.subtexel_bits + node.level;
            let half = 1i << (shift - 1u);
            let first = (node.cell << vec2<u32>(NODE_BITS));
            var c = ((cell + half) >> vec2<u32>(shift)) - first;
            let scale = inverse_power(shift);
            let origin = vec2<f32>((first << vec2<u32>(shift)) - half - frame.anchor);
            let path = path_of(o, d, origin, shift);
            // a ray that starts on the ground, or is under it, meets cells next; others start at coarse blocks
            let low = (!from_below && t == from_t) || (!STAYS_ABOVE && side == BELOW);
            var k = select(START, LEAST, low);
            var way_out: Crossing;
            // the ray's height, sheared as ceilings are: from here on it is this or more
            var sheared = -1e30;
            var clear = false;
            if (ANY_HIT && clipmap.sun_ready != 0u && side == ABOVE && z.y + 2.0 * t * z.z >= clipmap.sun_rise) {
                let place = o + t * d - origin;
                sheared = height_on(z, t) - dot(clipmap.sun_slope, place);
                if (sheared >= ceiling_over(node.slot, c)) {
                    // it may have come under the surface where nodes of two levels meet
                    let h = height_quad(node.slot, c - 1);
                    let way = clamp(place * scale - vec2<f32>(c), vec2<f32>(0.0), vec2<f32>(1.0));
                    clear = height_on(z, t) > bilinear(h.x, h.y, h.z, h.w, way) - frame.eye_height;
                }
            }
            var over = false;   // whether it was above the surface somewhere in this node
            loop {
                if (ANY_HIT && clear) { break; }
                // over blocks that the ray clears, down to the next cell that it may meet: a loop of its own, so that
                // the lanes of a group come to their cells together
                loop {
                    steps += 1;
                    way_out = crossing_of(c, k, path);
                    if ((!EAGER && k == 0u) || steps > STEPS) { break; }
                    if (ANY_HIT && over && k == CEILING_BITS) {
                        clear = sheared >= ceiling_over(node.slot, c);
                        if (clear) { break; }
                    }
                    let highest = maximum_texel(node.slot, k, c >> vec2<u32>(k));
                    // a ray under the surface is never over a block, and meets every cell
                    let buried = EAGER && side == BELOW;
                    if (buried || lowest_on(z, t, clamp(way_out.t, t, node_end)) <= highest - frame.eye_height) {
                        k = select(k - 1u, 0u, STAYS_ABOVE && k == CEILING_BITS);
                        if (EAGER && k == 0u) { break; }
                        continue;
                    }
                    side = ABOVE;
                    over = true;
                    t = clamp(way_out.t, t, node_end);
                    if (way_out.t >= node_end) { break; }
                    let before = c;
                    c = next_cell(c, k, way_out, t, path);
                    if (k < NODE_BITS && (((before.x ^ c.x) | (before.y ^ c.y)) >> (k + 1u)) != 0) { k += 1u; }
                }
                if (steps > STEPS) { return miss; }
                if (k > 0u) { break; }
                if (EAGER) { way_out = crossing_of(c, 0u, path); }
                let end = clamp(way_out.t, t, node_end);

                // the cell between samples c - 1 and c
                let h = height_quad(node.slot, c - 1);
                let corner = ((first + c) << vec2<u32>(shift)) - half - frame.anchor;
                let way = clamp((o + t * d - vec2<f32>(corner)) * scale, vec2<f32>(0.0), vec2<f32>(1.0));
                let step = d * scale;
                let across = h.y - h.x;
                let along = h.z - h.x;
                let twist = h.w - h.y - along;
                // height over the surface as a polynomial of the way from t
                let f0 = height_on(z, t) - ((h.x - frame.eye_height) + across * way.x + along * way.y + twist * way.x * way.y);
                let f1 = z.y + 2.0 * z.z * t - (across * step.x + along * step.y + twist * (way.x * step.y + way.y * step.x));
                let f2 = z.z - twist * step.x * step.y;
                if (STAYS_ABOVE) {
                    // whether the parabola comes under zero: at an end, or between
                    let length = end - t;
                    let dips = f2 > 0.0 && f1 < 0.0 && -f1 < 2.0 * f2 * length && f1 * f1 >= 4.0 * f2 * f0;
                    if (f0 <= 0.0 || f0 + length * (f1 + length * f2) < 0.0 || dips) {
                        return Hit(true, t, node.level, node.cell, way);
                    }
                    t = end;
                    over = true;
                    if (way_out.t >= node_end) { break; }
                    let before = c;
                    c = next_cell(c, 0u, way_out, t, path);
                    let moved = (before.x ^ c.x) | (before.y ^ c.y);
                    if ((moved >> CEILING_BITS) != 0) { k = CEILING_BITS; }
                    continue;
                }
                if (side == UNKNOWN) { side = select(ABOVE, BELOW, f0 <= 0.0); }
                let crossing = first_crossing(f0, f1, f2, end - t, side == BELOW);
                if (crossing >= 0.0) {
                    let cover = cell_coverage(node.slot, c);
                    let there = clamp(way + crossing * step, vec2<f32>(0.0), vec2<f32>(1.0));
                    if ((side == ABOVE || from_below) && is_solid(cover, there)) {
                        return Hit(true, t + crossing, node.level, node.cell, there);
                    }
                    // on through the hole, or out of the ground; a twisted cell can be crossed back
                    let length = end - t;
                    let end_side = select(ABOVE, BELOW, f0 + length * (f1 + length * f2) < 0.0);
                    let back = f0 / select(-1.0, f2 * crossing, f2 * crossing != 0.0);
                    if (end_side == side && back > crossing && back <= length && (side == BELOW || from_below)) {
                        let again = clamp(way + back * step, vec2<f32>(0.0), vec2<f32>(1.0));
                        if (is_solid(cover, again)) {
                            return Hit(true, t + back, node.level, node.cell, again);
                        }
                    }
                    side = end_side;
                }
                t = end;
                let dives = side == BELOW && highest_on(z, t, node_end) < range.x - frame.eye_height;
                if (way_out.t >= node_end || dives) { break; }
                let before = c;
                c = next_cell(c, 0u, way_out, t, path);
                if (EAGER || (side != BELOW && (((before.x ^ c.x) | (before.y ^ c.y)) >> 1u) != 0)) { k = 1u; }
            }
        }
        t = node_end;
        if (t >= span.y) { return miss; }
        let axis = select(1u, 0u, node_exits.x <= node_exits.y);
        let other = 1u - axis;
        let before = cell;
        cell[axis] = select(node_low[axis] - 1, node_high[axis], forwards[axis]);
        let there = frame.anchor[other] + i32(floor(o[other] + t * d[other]));
        cell[other] = clamp(there, select(node_low[other], before[other], forwards[other]),
                            select(before[other], node_high[other] - 1, forwards[other]));
        if (cell[axis] < frame.extent[axis] || cell[axis] >= frame.extent[axis + 2u]) { return miss; }
        steps += 1;
        if (steps > STEPS) { break; }
    }
    return miss;
}

// The first way in [0, length] at which f0 + f1 s + f2 s^2 reaches zero from above (from below if `rising`); -1 if none.
// On the wrong side from the start is a crossing at once.
fn first_crossing(f0: f32, f1: f32, f2: f32, length: f32, rising: bool) -> f32 {
    let sign = select(1.0, -1.0, rising);
    let a = f2 * sign;
    let b = f1 * sign;
    let c = f0 * sign;
    if (c <= 0.0) { return 0.0; }
    let at_end = c + length * (b + length * a);
    let root = b * b - 4.0 * a * c;
    if (root < 0.0) { return select(-1.0, length, at_end < 0.0); }
    // c > 0: the first root is 2c / (-b + sqrt(root)), free of cancellation for b < 0; for b > 0 it needs a < 0
    let q = -b + sqrt(root);
    var s = -1.0;
    if (b <= 0.0) { if (q > 0.0) { s = 2.0 * c / q; } }
    else if (a < 0.0) { s = (-b - sqrt(root)) / (2.0 * a); }
    if (s >= 0.0 && s <= length) { return s; }
    return select(-1.0, length, at_end < 0.0);
}

// Coverage of the corners of the cell between samples c - 1 and c.
fn cell_coverage(slot: u32, c: vec2<i32>) -> vec4<f32> {
    if (COVERED) { return vec4<f32>(1.0); }
    let at = c + HEIGHT_BORDER;
    let layer = i32(slot);
    return vec4<f32>(
        textureLoad(coverage_atlas, at - 1, layer, 0).x, textureLoad(coverage_atlas, at + vec2<i32>(0, -1), layer, 0).x,
        textureLoad(coverage_atlas, at + vec2<i32>(-1, 0), layer, 0).x, textureLoad(coverage_atlas, at, layer, 0).x);
}

// Whether the surface exists at a place in a cell.
fn is_solid(cover: vec4<f32>, way: vec2<f32>) -> bool {
    return COVERED || bilinear(cover.x, cover.y, cover.z, cover.w, way) >= 0.5;
}

// Whether terrain stands between a camera-relative position on the ground and the sky in a direction. What was drawn may
// lie a little under the nodes that rays meet, and both are rounded: the ray starts just above the higher one. The
// direction is that of the sun whose ceilings are ready, if any are.
fn occluded(position: vec3<f32>, direction: vec3<f32>) -> bool {
    let p = clamp_to_extent(ground_point(position));
    let level = traversal_level(p.cell);
    let surface = lift(position.xy, height_at_level(p, level)).z;
    let margin = SHADOW_MARGIN * frame.spacing * f32(1u << level) + 2e-6 * length(position);
    let start = vec3<f32>(position.xy, max(position.z, surface) + margin);
    return trace(Ray(start, direction), 0.0, 1e30, false).found;
}
