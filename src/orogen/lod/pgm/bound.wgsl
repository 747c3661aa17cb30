#include pgm.wgsl
#include cells.wgsl
#include trace.wgsl
// The error-bounded variant (after Löffler, Rybacki and Schumann 2009): finds the cells whose screen-space error may be
// above the bound, with a prism around all that is drawn and all that should be there.

@group(1) @binding(2) var<storage, read> placed: array<Placed>;
@group(1) @binding(3) var<uniform> limit: Limit;
@group(1) @binding(4) var<storage, read_write> arguments: array<atomic<u32>, 4>;   // of the prisms' draw
@group(1) @binding(5) var<storage, read_write> prisms: array<Prism>;

struct Limit {
    forward: vec3<f32>,   // view axis of the LOD camera
    pixels: f32,          // screen-space error that is allowed
    pixel_metres: f32,    // that a pixel covers, orthographic; 0 for perspective
    near: f32,
    secant: f32,          // distance over view depth in the picture's corners
    padding: f32,
}

const LINES = 8;          // lines of samples that a triangle may span at most, before a coarser level stands for them

// How far the surface lies from a triangle, and its range, in metres of the data.
struct Span { away: f32, low: f32, high: f32 }

fn coordinate(p: Point, base: vec2<i32>, shift: u32) -> vec2<f32> {
    return (vec2<f32>(p.cell - base) + p.frac) * inverse_power(shift);
}

// Between two lines of samples the surface is bilinear over the triangle's bounding box, and so is what separates it
// from the triangle's plane: the extremes lie where the box's sides and the lines of samples meet.
fn span_of(a: Placed, b: Placed, c: Placed) -> Span {
    let low_cell = min(min(a.cell, b.cell), c.cell);
    let high_cell = max(max(a.cell, b.cell), c.cell) + 1;
    let middle = low_cell + (high_cell - low_cell) / 2;
    let base_level = traversal_level(clamp(middle, frame.extent.xy, frame.extent.zw - 1));
    let side = max(high_cell.x - low_cell.x, high_cell.y - low_cell.y);
    var level = base_level;
    let top = clipmap.layers[HEIGHTS].level_count - 1u;
    while (level < top && side > (LINES << (frame.subtexel_bits + level))) { level += 1u; }

    // in texels of the level, whole where its samples are
    let shift = frame.subtexel_bits + level;
    let half = 1i << (shift - 1u);
    let base = ((low_cell - half) >> vec2<u32>(shift) << vec2<u32>(shift)) + half;
    let pa = coordinate(Point(a.cell, a.frac), base, shift);
    let pb = coordinate(Point(b.cell, b.frac), base, shift);
    let pc = coordinate(Point(c.cell, c.frac), base, shift);
    let low = min(min(pa, pb), pc);
    let high = max(max(pa, pb), pc);
    let u = pb - pa;
    let v = pc - pa;
    let area = u.x * v.y - u.y * v.x;
    var span = Span(0.0, min(min(a.height, b.height), c.height), max(max(a.height, b.height), c.height));
    if (area == 0.0) { return span; }
    let slope = vec2<f32>(v.y * (b.height - a.height) - u.y * (c.height - a.height),
                          u.x * (c.height - a.height) - v.x * (b.height - a.height)) / area;

    let last = vec2<i32>(ceil(high));
    var error = 0.0;
    for (var y = i32(floor(low.y)); y <= last.y; y += 1) {
        for (var x = i32(floor(low.x)); x <= last.x; x += 1) {
            let at = clamp(vec2<f32>(vec2<i32>(x, y)), low, high);
            let offset = at * f32(1u << shift);
            let whole = floor(offset);
            let p = clamp_to_extent(Point(base + vec2<i32>(whole), offset - whole));
            let node = lookup(HEIGHTS, p.cell, level);
            let h = node_height(p, node);
            let away = abs(h - (a.height + dot(slope, at - pa)));
            span = Span(max(span.away, away), min(span.low, h), max(span.high, h));
            // a coarser level stands for what lies below it
            if (node.level > base_level) { error = max(error, slot_bounds[node.slot].error); }
        }
    }
    error *= select(1.0, 2.0, base_level > 0u);
    return Span(span.away + error, span.low - error, span.high + error);
}

fn position_of(v: Placed) -> vec3<f32> { return lift(flat_position(Point(v.cell, v.frac)), v.height); }

// Pixels by which a vertical error of so many metres may show in a triangle, from the Jacobian of the projection.
fn pixels_of(metres: f32, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> f32 {
    if (limit.pixel_metres > 0.0) { return metres / limit.pixel_metres; }
    let depths = vec3<f32>(dot(a, limit.forward), dot(b, limit.forward), dot(c, limit.forward));
    let nearest = max(min(min(depths.x, depths.y), depths.z), limit.near) - metres;
    if (nearest <= 0.0) { return 1e30; }
    let secants = vec3<f32>(length(a), length(b), length(c)) / max(depths, vec3<f32>(1e-9));
    let secant = min(max(max(secants.x, secants.y), secants.z), limit.secant);
    return frame.lod_pixels_per_radian * metres * secant / nearest;
}

// Whether the prism over four places lies outside one of the frustum's planes.
fn outside_frustum(corners: array<Placed, 4>, low: f32, high: f32) -> bool {
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        var most = -1e30;
        for (var k = 0u; k < 4u; k += 1u) {
            let flat = flat_position(Point(corners[k].cell, corners[k].frac));
            most = max(most, max(dot(plane.xyz, lift(flat, low)), dot(plane.xyz, lift(flat, high))));
        }
        if (most + plane.w < 0.0) { return true; }
    }
    return false;
}

@compute @workgroup_size(64)
fn find_cells(@builtin(global_invocation_id) id: vec3<u32>) {
    let cell = id.y * 65536u + id.x;
    if (cell >= pgm.columns * pgm.rows) { return; }
    let at = vec2<u32>(cell % pgm.columns, cell / pgm.columns);
    var corners: array<Placed, 4>;
    for (var k = 0u; k < 4u; k += 1u) { corners[k] = placed[vertex_number(at, k)]; }
    let diagonal = triangles_of(at);
    let first = span_of(corners[diagonal[0]], corners[diagonal[1]], corners[diagonal[2]]);
    let second = span_of(corners[diagonal[1]], corners[diagonal[2]], corners[diagonal[3]]);

    var p: array<vec3<f32>, 4>;
    for (var k = 0u; k < 4u; k += 1u) { p[k] = position_of(corners[diagonal[k]]) - frame.lod_eye; }
    // a triangle is flat where the ground bends
    let longest = max(max(distance(p[0].xy, p[1].xy), distance(p[1].xy, p[2].xy)),
                      max(distance(p[0].xy, p[2].xy), max(distance(p[1].xy, p[3].xy), distance(p[2].xy, p[3].xy))));
    let bend = frame.curvature * longest * longest / frame.exaggeration;
    let away = max(pixels_of((first.away + bend) * frame.exaggeration, p[0], p[1], p[2]),
                   pixels_of((second.away + bend) * frame.exaggeration, p[1], p[2], p[3]));
    if (away <= limit.pixels) { return; }
    // wider than rounding
    let margin = bend + 1e-5 * max(length(p[0]), length(p[3])) / frame.exaggeration;
    let low = min(first.low, second.low) - margin;
    let high = max(first.high, second.high) + margin;
    if (outside_frustum(corners, low, high)) { return; }
    prisms[atomicAdd(&arguments[1], 1u)] = Prism(cell, low, high);
}
