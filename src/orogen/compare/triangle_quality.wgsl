#include frame.wgsl
#include lod_vertex.wgsl
// Counts the triangles of draws by their smallest angle. Lengths are metres of the data, as on a map and before
// exaggeration; a triangle is degenerate where it has no area in space.

const QUALITY_MESHES = 0u;          // draws with an index list
const QUALITY_STRIPS = 2u;
const QUALITY_KIND = #{QUALITY_KIND}u;
const QUALITY_BIN = #{QUALITY_BIN}; // degrees
const QUALITY_BINS = #{QUALITY_BINS}u;
const QUALITY_SUMS = 2u + QUALITY_BINS;
const QUALITY_ROW = 65536u;         // invocations in a row of the dispatch
const QUALITY_ROUND = 1e-3;         // degrees: keeps the round angles of regular grids together
const QUALITY_ULP = 2.4e-7;         // rounding of coordinates, relative to the largest

struct QualityDraw {
    end: u32,           // triangles of this draw and those before it
    first: u32,         // index, or vertex without an index list
    base_vertex: u32,
    triangles: u32,     // an instance
}

struct QualityTotals {
    degenerate: atomic<u32>,
    angle_low: atomic<u32>,         // thousandths of a degree
    angle_high: atomic<u32>,
    angles: array<atomic<u32>, QUALITY_BINS>,
}

@group(2) @binding(0) var<storage, read> quality_draws: array<QualityDraw>;
@group(2) @binding(1) var<storage, read> quality_indices: array<u32>;
@group(2) @binding(2) var<storage, read_write> quality_totals: QualityTotals;

// Of a workgroup: degenerate triangles, angles, and triangles by angle.
var<workgroup> quality_sums: array<atomic<u32>, QUALITY_SUMS>;

@compute @workgroup_size(64)
fn measure_triangles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let number = id.y * QUALITY_ROW + id.x;
    // not every driver hands workgroup memory out zeroed
    if (local < QUALITY_SUMS) { atomicStore(&quality_sums[local], 0u); }
    workgroupBarrier();
    if (number < quality_draws[arrayLength(&quality_draws) - 1u].end) { quality_count(number); }
    workgroupBarrier();
    if (local >= QUALITY_SUMS) { return; }
    let sum = atomicLoad(&quality_sums[local]);
    if (local == 0u) { atomicAdd(&quality_totals.degenerate, sum); }
    else if (local == 1u) { quality_add_angle(sum); }
    else { atomicAdd(&quality_totals.angles[local - 2u], sum); }
}

fn quality_add_angle(angle: u32) {
    let before = atomicAdd(&quality_totals.angle_low, angle);
    if (before + angle < before) { atomicAdd(&quality_totals.angle_high, 1u); }
}

fn quality_count(number: u32) {
    var low = 0u;
    var high = arrayLength(&quality_draws) - 1u;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (number < quality_draws[middle].end) { high = middle; } else { low = middle + 1u; }
    }
    let draw = quality_draws[low];
    var start = 0u;
    if (low > 0u) { start = quality_draws[low - 1u].end; }
    let corners = quality_corners(draw, (number - start) % draw.triangles);
    let instance = (number - start) / draw.triangles;
    let angle = quality_angle(
        lod_vertex(corners.x, instance), lod_vertex(corners.y, instance), lod_vertex(corners.z, instance)
    );
    if (angle < 0.0) {
        atomicAdd(&quality_sums[0], 1u);
        return;
    }
    atomicAdd(&quality_sums[1], u32(round(1000.0 * angle)));
    atomicAdd(&quality_sums[2u + min(u32((angle + QUALITY_ROUND) / QUALITY_BIN), QUALITY_BINS - 1u)], 1u);
}

fn quality_corners(draw: QualityDraw, triangle: u32) -> vec3<u32> {
    if (QUALITY_KIND == QUALITY_STRIPS) { return draw.first + triangle + vec3<u32>(0u, 1u, 2u); }
    let at = draw.first + 3u * triangle + vec3<u32>(0u, 1u, 2u);
    if (QUALITY_KIND != QUALITY_MESHES) { return at; }
    return draw.base_vertex + vec3<u32>(quality_indices[at.x], quality_indices[at.y], quality_indices[at.z]);
}

// The smallest angle in degrees, below 0 for a triangle without area.
fn quality_angle(a: LodVertex, b: LodVertex, c: LodVertex) -> f32 {
    if (quality_same(a, b) || quality_same(b, c) || quality_same(c, a)) { return -1.0; }
    // the corners turned so that the shortest edge is first: the smallest angle is opposite, and cancels least
    var first = quality_edge(a, b);
    var second = quality_edge(b, c);
    var third = quality_edge(c, a);
    let lengths = vec3<f32>(length(first), length(second), length(third));
    let shortest = min(min(lengths.x, lengths.y), lengths.z);
    let longest = max(max(lengths.x, lengths.y), lengths.z);
    if (lengths.y == shortest) {
        let turned = first;
        first = second;
        second = third;
        third = turned;
    } else if (lengths.z == shortest) {
        let turned = third;
        third = second;
        second = first;
        first = turned;
    }
    let doubled = length(cross(first, second));
    let largest = max(max(max(abs(a.height), abs(b.height)), abs(c.height)), longest);
    if (!quality_has_ground(a.point, b.point, c.point) && doubled <= QUALITY_ULP * largest * longest) { return -1.0; }
    return degrees(atan2(doubled, -dot(second, third)));
}

fn quality_same(a: LodVertex, b: LodVertex) -> bool {
    return all(a.point.cell == b.point.cell) && all(a.point.frac == b.point.frac) && a.height == b.height;
}

fn quality_edge(a: LodVertex, b: LodVertex) -> vec3<f32> {
    let step = vec2<f32>(b.point.cell - a.point.cell) + (b.point.frac - a.point.frac);
    return vec3<f32>(to_metres(step), b.height - a.height);
}

// Whether a triangle certainly has area on the map: exact, where its corners lie on whole subtexels.
fn quality_has_ground(a: Point, b: Point, c: Point) -> bool {
    if (any(a.frac != b.frac) || any(a.frac != c.frac)) { return false; }
    let ab = b.cell - a.cell;
    let ac = c.cell - a.cell;
    let left = quality_product(ab.x, ac.y);
    let right = quality_product(ab.y, ac.x);
    return any(left != right);
}

// Sign, and the 64 bits of the size, of a product.
fn quality_product(a: i32, b: i32) -> vec3<u32> {
    let x = u32(abs(a));
    let y = u32(abs(b));
    let low = (x & 0xffffu) * (y & 0xffffu);
    let one = (x >> 16u) * (y & 0xffffu) + (low >> 16u);
    let other = (x & 0xffffu) * (y >> 16u) + (one & 0xffffu);
    let high = (x >> 16u) * (y >> 16u) + (one >> 16u) + (other >> 16u);
    return vec3<u32>(u32(sign(a) * sign(b) + 1), high, (other << 16u) | (low & 0xffffu));
}
