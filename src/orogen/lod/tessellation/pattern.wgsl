// The pattern into which graphics hardware divides a quad, given a factor for each edge and two for the inside: that of
// the reference tessellator of Direct3D 11, which OpenGL and Vulkan share. Points have parameters from 0 to 1 with 16
// fractional bits. Edges are numbered west (u = 0), north (v = 0), east, south, and run clockwise: the west edge from
// south to north, the north edge from west to east and so on.

const WHOLE = #{WHOLE};   // factors are rounded up to whole numbers, which may be even or odd
const ODD = #{ODD};       // otherwise edges have an odd number of segments, or an even one
const ONE = 65536u;
const FEWEST = select(select(2.0, 1.0, ODD), 1.0, WHOLE);
const MOST = select(select(64.0, 63.0, ODD), 64.0, WHOLE);

// Points along an edge. Between two numbers of segments they move from where the smaller has them to where the larger
// has them: one point of either half splits in two. The second half mirrors the first.
struct Spacing {
    odd: bool,
    half: u32,           // points of the first half; even numbers of segments have another one in the middle
    parting: u32,        // the points behind this one are one further in the larger number
    fraction: u32,       // way from the smaller number to the larger
    small_step: u32,     // length of a segment of the smaller number
    large_step: u32,
}

struct Pattern {
    outer: array<Spacing, 4>,
    inner: array<Spacing, 2>,
    bare: bool,            // two triangles and nothing else
    edge_points: u32,      // on the outline
    grid: vec2<u32>,       // points inside, columns and rows
    points: u32,
    edge_triangles: u32,   // between the outline and the outermost points inside
    triangles: u32,
}

fn without_highest_bit(n: u32) -> u32 { return n & ~(1u << firstLeadingBit(n)); }

fn reciprocal(n: u32) -> u32 { return (ONE + n / 2u) / n; }

fn spacing(factor: f32, odd: bool) -> Spacing {
    var half = (u32(round(factor * f32(ONE))) + 1u) / 2u;
    // an inside of a single segment counts as two
    if (odd || half == ONE / 2u) { half += ONE / 2u; }
    let small = half / ONE;
    let large = (half + ONE - 1u) / ONE;
    var parting = large + 1u;
    if (small != large) {
        let n = small - u32(odd);
        parting = select(2u * without_highest_bit(n) + 1u, 0u, n == 0u);
    }
    let missing = u32(odd);
    return Spacing(odd, large, parting, half % ONE, reciprocal(2u * small - missing), reciprocal(2u * large - missing));
}

fn point_count(s: Spacing) -> u32 { return 2u * s.half + u32(!s.odd); }

fn location(s: Spacing, point: u32) -> u32 {
    let mirrored = point >= s.half;
    let k = select(point, 2u * s.half - u32(s.odd) - point, mirrored);
    if (k == s.half) { return ONE / 2u; }
    let small = (k - u32(k > s.parting)) * s.small_step;
    let large = k * s.large_step;
    let way = (small * (ONE - s.fraction) + large * s.fraction + ONE / 2u) / ONE;
    return select(way, ONE - way, mirrored);
}

fn pattern_of(outer: vec4<f32>, inner: vec2<f32>) -> Pattern {
    var o = clamp(outer, vec4<f32>(FEWEST), vec4<f32>(MOST));
    var i = clamp(inner, vec2<f32>(FEWEST), vec2<f32>(MOST));
    if (WHOLE) {
        o = ceil(o);
        i = ceil(i);
    }
    let tiny = 1.0 / f32(ONE);
    let divided = any(o > vec4<f32>(1.0 + 0.5 * tiny)) || any(i > vec2<f32>(1.0 + 0.5 * tiny));
    // where an edge is divided, points inside grow out of the outline
    if (ODD && !WHOLE && divided) { i = max(i, vec2<f32>(1.0 + tiny)); }
    var p: Pattern;
    p.bare = !divided;
    if (p.bare) {
        p.points = 4u;
        p.triangles = 2u;
        return p;
    }
    for (var edge = 0u; edge < 4u; edge += 1u) {
        p.outer[edge] = spacing(o[edge], select(ODD, u32(o[edge]) % 2u == 1u, WHOLE));
        p.edge_points += point_count(p.outer[edge]) - 1u;
    }
    for (var axis = 0u; axis < 2u; axis += 1u) {
        p.inner[axis] = spacing(i[axis], select(ODD, u32(i[axis]) % 2u == 1u && i[axis] != 1.0, WHOLE));
        p.grid[axis] = point_count(p.inner[axis]) - 2u;
    }
    p.points = p.edge_points + p.grid.x * p.grid.y;
    p.edge_triangles = p.edge_points + 2u * (p.grid.x + p.grid.y) - 4u;
    p.triangles = p.edge_triangles + 2u * (p.grid.x - 1u) * (p.grid.y - 1u);
    return p;
}

// Parameters of a point: those of the outline clockwise from the south-west, then those inside row by row.
fn parameters(p: ptr<function, Pattern>, point: u32) -> vec2<u32> {
    if ((*p).bare) { return vec2<u32>(u32(point == 1u || point == 2u), u32(point >= 2u)) * ONE; }
    if (point >= (*p).edge_points) {
        let n = point - (*p).edge_points;
        return vec2<u32>(location((*p).inner[0], 1u + n % (*p).grid.x), location((*p).inner[1], 1u + n / (*p).grid.x));
    }
    var n = point;
    var edge = 0u;
    while (n >= point_count((*p).outer[edge]) - 1u) {
        n -= point_count((*p).outer[edge]) - 1u;
        edge += 1u;
    }
    let last = point_count((*p).outer[edge]) - 1u;
    let along = location((*p).outer[edge], select(n, last - n, edge == 0u || edge == 3u));
    switch (edge) {
        case 0u: { return vec2<u32>(0u, along); }
        case 1u: { return vec2<u32>(along, 0u); }
        case 2u: { return vec2<u32>(ONE, along); }
        default: { return vec2<u32>(along, ONE); }
    }
}

fn inside(p: ptr<function, Pattern>, column: u32, row: u32) -> u32 {
    return (*p).edge_points + row * (*p).grid.x + column;
}

// Two rows of points that are to be stitched: an edge of the outline, and the outermost points inside along it.
struct Rows { edge: u32, start: u32, outer_last: u32, inner_last: u32, mirrored: bool }

fn outer_point(p: ptr<function, Pattern>, rows: Rows, n: u32) -> u32 {
    return (rows.start + select(n, rows.outer_last - n, rows.mirrored)) % (*p).edge_points;
}

fn inner_point(p: ptr<function, Pattern>, rows: Rows, n: u32) -> u32 {
    let k = select(n, rows.inner_last - n, rows.mirrored);
    let last = (*p).grid - 1u;
    switch (rows.edge) {
        case 0u: { return inside(p, 0u, last.y - k); }
        case 1u: { return inside(p, k, 0u); }
        case 2u: { return inside(p, last.x, k); }
        default: { return inside(p, last.x - k, last.y); }
    }
}

// The steps that half a row of so many points takes, one bit each, in a walk of 32 steps: with few points those that
// are multiples of 16, then of 8 and so on, one after the other.
fn steps(points: u32) -> u32 {
    if (points < 2u) { return 0u; }
    var combs = array(0x00000001u, 0x00010001u, 0x01010101u, 0x11111111u, 0x55555555u, 0xffffffffu, 0xffffffffu);
    let whole = firstLeadingBit(points);
    let end = without_highest_bit(points) << (5u - whole);
    let finer = combs[whole + 1u] & ~combs[whole] & ((1u << end) - 1u);
    return (combs[whole] & ~1u) | finer;
}

fn before(bits: u32, step: u32) -> u32 { return countOneBits(bits & ((1u << step) - 1u)); }

// The n-th triangle between two rows. Both are walked at once, from their ends to the middle; in a step each row may move
// on by a segment, the inner one first, and each segment makes a triangle with the point reached in the other row.
fn stitch(p: ptr<function, Pattern>, edge: u32, start: u32, n: u32) -> vec3<u32> {
    let outer = (*p).outer[edge];
    let inner = (*p).inner[(edge + 1u) % 2u];
    var rows = Rows(edge, start, point_count(outer) - 1u, point_count(inner) - 3u, false);
    let outer_half = outer.half - u32(outer.odd);
    let inner_half = inner.half - u32(inner.odd);
    let half_count = outer_half + inner_half - 1u;
    let count = rows.outer_last + rows.inner_last;
    if (n >= half_count && n < count - half_count) {
        // segments in the middle of odd numbers
        let o = outer_half;
        let i = inner_half - 1u;
        if (inner.odd && n == half_count) {
            return vec3<u32>(inner_point(p, rows, i), outer_point(p, rows, o), inner_point(p, rows, i + 1u));
        }
        return vec3<u32>(inner_point(p, rows, i + u32(inner.odd)), outer_point(p, rows, o), outer_point(p, rows, o + 1u));
    }
    rows.mirrored = n >= half_count;
    let triangle = select(n, count - 1u - n, rows.mirrored);
    // the outer row, which is longer, is a segment ahead
    let ahead = min(outer_half, 1u);
    if (triangle < ahead) {
        return vec3<u32>(outer_point(p, rows, 0u), outer_point(p, rows, 1u), inner_point(p, rows, 0u));
    }
    let outer_steps = steps(outer_half);
    let inner_steps = steps(inner_half);
    var step = 0u;
    for (var jump = 16u; jump > 0u; jump /= 2u) {
        let next = step + jump;
        if (ahead + before(outer_steps, next) + before(inner_steps, next) <= triangle) { step = next; }
    }
    let o = ahead + before(outer_steps, step);
    let i = before(inner_steps, step);
    let inner_moves = ((inner_steps >> step) & 1u) == 1u;
    if (inner_moves && triangle == o + i) {
        return vec3<u32>(outer_point(p, rows, o), inner_point(p, rows, i), inner_point(p, rows, i + 1u));
    }
    return vec3<u32>(outer_point(p, rows, o), outer_point(p, rows, o + 1u), inner_point(p, rows, i + u32(inner_moves)));
}

// The points of a triangle.
fn triangle_of(p: ptr<function, Pattern>, triangle: u32) -> vec3<u32> {
    if ((*p).bare) { return select(vec3<u32>(1u, 2u, 3u), vec3<u32>(0u, 1u, 3u), triangle == 0u); }
    if (triangle < (*p).edge_triangles) {
        var n = triangle;
        var start = 0u;
        for (var edge = 0u; edge < 4u; edge += 1u) {
            let segments = point_count((*p).outer[edge]) - 1u;
            let count = segments + (*p).grid[(edge + 1u) % 2u] - 1u;
            if (n < count) { return stitch(p, edge, start, n); }
            n -= count;
            start += segments;
        }
    }
    let n = triangle - (*p).edge_triangles;
    let quads = (*p).grid - 1u;
    let at = vec2<u32>(n / 2u % quads.x, n / 2u / quads.x);
    // diagonals point to the middle; a row in the middle has those that rise to the east, a column those that fall
    let toward = sign(vec2<i32>(quads) - 1 - 2 * vec2<i32>(at));
    let falling = toward.y != 0 && (toward.x == 0 || toward.x == toward.y);
    let a = inside(p, at.x, at.y);
    let b = a + 1u;
    let c = a + (*p).grid.x;
    let d = c + 1u;
    if (falling) { return select(vec3<u32>(a, c, d), vec3<u32>(a, d, b), n % 2u == 0u); }
    return select(vec3<u32>(b, c, d), vec3<u32>(a, c, b), n % 2u == 0u);
}
