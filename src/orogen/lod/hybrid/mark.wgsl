#include lod/tiles.wgsl
#include counts.wgsl
#include blocks.wgsl
#include frustum.wgsl
#include trace.wgsl
// Where rays are cast: the blocks of pixels that may show the box of a ray tile, and where a ray enters one there at the
// earliest. A workgroup per tile.

const GROUP = 64u;
const MARK_COLUMNS = 1024u;
const SLACK = 1.0;          // pixels that a box is taken larger: rounding
const FAR_OFF = 1e5;        // pixels beyond which positions are too coarse to tell what is beside them

@group(1) @binding(1) var<storage, read> chosen_tiles: array<FinalTile>;
@group(1) @binding(2) var<storage, read> counts: Counts;
@group(1) @binding(3) var<storage, read_write> blocks: array<Block>;

var<workgroup> lowest: array<f32, GROUP>;
var<workgroup> clip: array<vec4<f32>, 8>;            // corners: bits of x, y and up
var<workgroup> low_pixel: array<atomic<i32>, 2>;
var<workgroup> high_pixel: array<atomic<i32>, 2>;
var<workgroup> nearest: atomic<u32>;                 // bits of the reverse depth
var<workgroup> sides: array<vec3<f32>, 12>;          // outlines of the box on screen: normal, which points outwards, and offset

fn to_pixels(p: vec4<f32>) -> vec2<f32> {
    return (vec2<f32>(0.5, -0.5) * p.xy / p.w + 0.5) * vec2<f32>(frame.size);
}

// In front of the near plane, under reverse z.
fn in_front(p: vec4<f32>) -> f32 { return p.w - p.z; }

fn include_pixel(p: vec4<f32>) {
    let pixel = clamp(to_pixels(p), vec2<f32>(-FAR_OFF), vec2<f32>(FAR_OFF));
    for (var axis = 0u; axis < 2u; axis += 1u) {
        atomicMin(&low_pixel[axis], i32(floor(pixel[axis] - SLACK)));
        atomicMax(&high_pixel[axis], i32(ceil(pixel[axis] + SLACK)));
    }
    atomicMax(&nearest, bitcast<u32>(clamp(p.z / p.w, 0.0, 1.0)));
}

// The rectangle of a tile in subtexels.
struct Ground { low: vec2<i32>, high: vec2<i32> }

fn ground_of(tile: FinalTile) -> Ground {
    let low = tile_corner(Tile(tile.x, tile.y, tile.level));
    return Ground(low, min(low + quad_size(tile.level) * i32(tiling.grid_size), frame.extent.zw));
}

// The cells of a ground that lie in the node that rays meet in one of its places.
struct Cells { node: Node, first: vec2<i32>, last: vec2<i32> }

fn cells_around(place: vec2<i32>, ground: Ground) -> Cells {
    let node = lookup(HEIGHTS, place, traversal_level(place));
    let asked = vec2<u32>(frame.subtexel_bits + NODE_BITS + node.asked);
    let low = max(ground.low, (place >> asked) << asked);
    let high = min(ground.high, ((place >> asked) + 1) << asked);
    let shift = vec2<u32>(frame.subtexel_bits + node.level);
    let half = 1i << (shift.x - 1u);
    let start = node.cell << vec2<u32>(NODE_BITS);
    return Cells(node, ((low + half) >> shift) - start, ((high - 1 + half) >> shift) - start);
}

// Highest sample, from the maximum pyramid.
fn highest_in(cells: Cells) -> f32 {
    var k = 1u;
    while (k < NODE_BITS && any((cells.last >> vec2<u32>(k)) - (cells.first >> vec2<u32>(k)) > vec2<i32>(1))) { k += 1u; }
    var highest = -1e30;
    for (var y = cells.first.y >> k; y <= cells.last.y >> k; y += 1) {
        for (var x = cells.first.x >> k; x <= cells.last.x >> k; x += 1) {
            highest = max(highest, maximum_texel(cells.node.slot, k, vec2<i32>(x, y)));
        }
    }
    return highest;
}

// Highest of what rays can meet over a ground: what is no wider than a node lies in those of its corners.
fn highest_over(ground: Ground, bound: f32) -> f32 {
    if (any(ground.high - ground.low > vec2<i32>(1i << (frame.subtexel_bits + NODE_BITS)))) { return bound; }
    var highest = -1e30;
    for (var i = 0; i < 4; i += 1) {
        let cells = cells_around(select(ground.low, ground.high - 1, vec2<bool>((i & 1) != 0, i > 1)), ground);
        if (cells.node.slot == NO_SLOT) { return bound; }
        highest = max(highest, highest_in(cells));
    }
    return min(bound, highest);
}

// Whether rays and triangles take all heights of a tile from the same node.
fn is_in_one_node(tile: FinalTile, ground: Ground, cells: Cells) -> bool {
    let asked = vec2<u32>(frame.subtexel_bits + NODE_BITS + cells.node.asked);
    return all((ground.low >> asked) == ((ground.high - 1) >> asked)) && tile.node == (cells.node.slot | (cells.node.level << 16u));
}

// Lowest of the samples around a tile's border, a part of them for each invocation.
fn lowest_around(cells: Cells, local: u32) -> f32 {
    var lowest = 1e30;
    // cells lie between two samples each way
    let from_sample = cells.first - 1;
    let count = cells.last - from_sample + 1;
    for (var i = i32(local); i < count.x + count.y; i += i32(GROUP)) {
        let upright = i >= count.x;
        let along = select(i, i - count.x, upright);
        for (var line = 0; line < 4; line += 1) {
            let across = select(cells.last, cells.first, vec2<bool>(line < 2)) - (line & 1);
            let at = select(vec2<i32>(from_sample.x + along, across.y), vec2<i32>(across.x, from_sample.y + along), upright);
            lowest = min(lowest, height_texel(cells.node.slot, at));
        }
    }
    return lowest;
}

// Whether rays come from above: those that meet what lies in a tile lower than all of its border have then crossed the box
// over that before. Not so through voids, in at the edge of the data, or with the eye under the ground or over the tile.
fn comes_from_above(ground: Ground) -> bool {
    if (clipmap.layers[HEIGHTS].covered == 0u || frame.forward.w > 0.5) { return false; }
    let eye = point_at(frame.eye_offset);
    if (any(eye.cell < frame.extent.xy) || any(eye.cell >= frame.extent.zw)) { return false; }
    if (all(eye.cell >= ground.low - 1) && all(eye.cell <= ground.high)) { return false; }
    return frame.eye_height > height_at(eye);
}

// A corner of the box around everything that rays can meet over a tile.
fn corner_of(ground: Ground, bounds: vec2<f32>, corner: u32) -> vec4<f32> {
    let low = vec2<f32>(ground.low - frame.anchor) - frame.eye_offset;
    let high = vec2<f32>(ground.high - frame.anchor) - frame.eye_offset;
    let a = to_metres(low);
    let b = to_metres(high);
    let c = to_metres(vec2<f32>(low.x, high.y));
    let lid = (corner & 4u) != 0u;
    let flat = to_metres(select(low, high, vec2<bool>((corner & 1u) != 0u, (corner & 2u) != 0u)));
    // the ground is bent down by the square of its distance: the floor as at the farthest, the lid as at the nearest point
    let middle = length(0.5 * (a + b));
    let reach = 0.5 * max(distance(a, b), length(a + b - 2.0 * c));
    let way = select(middle + reach, max(middle - reach, 0.0), lid);
    let up = (select(bounds.x, bounds.y, lid) - frame.eye_height) * frame.exaggeration - frame.curvature * way * way;
    let slack = select(-1e-6, 1e-6, lid) * (abs(up) + way);
    return frame.view_projection * vec4<f32>(flat, up + slack, 1.0);
}

// Line through an edge of the box with all of the box on one side: the normal away from it and the offset; 0 if none.
fn side_of(a: u32, b: u32) -> vec3<f32> {
    var away = 0.0;
    let start = to_pixels(clip[a]);
    let along = to_pixels(clip[b]) - start;
    if (!(dot(along, along) > 1e-4)) { return vec3<f32>(0.0); }
    var normal = normalize(vec2<f32>(-along.y, along.x));
    var span = vec2<f32>(0.0);
    for (var i = 0u; i < 8u; i += 1u) {
        let p = to_pixels(clip[i]);
        if (in_front(clip[i]) <= 0.0 || any(abs(p) > vec2<f32>(FAR_OFF))) { return vec3<f32>(0.0); }
        let off = dot(normal, p - start);
        span = vec2<f32>(min(span.x, off), max(span.y, off));
    }
    if (span.x < -1e-2 && span.y > 1e-2) { return vec3<f32>(0.0); }
    if (span.y > 1e-2) { normal = -normal; }
    return vec3<f32>(normal, dot(normal, start));
}

@compute @workgroup_size(GROUP)
fn mark_blocks(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let number = group.y * MARK_COLUMNS + group.x;
    if (number >= counts.rays) { return; }
    let tile = chosen_tiles[tiling.tile_capacity - 1u - number];
    let ground = ground_of(tile);
    let cells = cells_around(ground.low, ground);
    let from_above = is_in_one_node(tile, ground, cells) && comes_from_above(ground);
    if (from_above) { lowest[local] = lowest_around(cells, local); }
    if (local < 2u) {
        atomicStore(&low_pixel[local], i32(FAR_OFF));
        atomicStore(&high_pixel[local], -i32(FAR_OFF));
        if (local == 0u) { atomicStore(&nearest, 0u); }
    }
    workgroupBarrier();
    if (local < 8u) {
        var bounds = bounds_around(ground.low, ground.high);
        if (from_above) {
            bounds.x = 1e30;
            for (var i = 0u; i < GROUP; i += 1u) { bounds.x = min(bounds.x, lowest[i]); }
        }
        bounds.y = highest_over(ground, bounds.y);
        clip[local] = corner_of(ground, bounds, local);
    }
    workgroupBarrier();
    if (local < 12u) {
        // the edge along an axis from each corner that lies low on it
        let axis = local / 4u;
        let rest = local & 3u;
        let a = (rest & ((1u << axis) - 1u)) | ((rest >> axis) << (axis + 1u));
        let b = a | (1u << axis);
        let fa = in_front(clip[a]);
        let fb = in_front(clip[b]);
        if (fa >= 0.0) { include_pixel(clip[a]); }
        if (fb >= 0.0) { include_pixel(clip[b]); }
        if ((fa < 0.0) != (fb < 0.0)) {
            include_pixel(mix(clip[a], clip[b], fa / (fa - fb)));
            // the eye may be inside
            atomicMax(&nearest, bitcast<u32>(1.0));
        }
        sides[local] = side_of(a, b);
    }
    workgroupBarrier();
    let most = vec2<i32>(block_count()) - 1;
    let first = max(vec2<i32>(atomicLoad(&low_pixel[0]), atomicLoad(&low_pixel[1])) >> vec2<u32>(BLOCK_BITS), vec2<i32>(0));
    let last = min(vec2<i32>(atomicLoad(&high_pixel[0]), atomicLoad(&high_pixel[1])) >> vec2<u32>(BLOCK_BITS), most);
    if (any(first > last)) { return; }
    let size = last - first + 1;
    let entry = max(atomicLoad(&nearest), 1u);
    for (var i = i32(local); i < size.x * size.y; i += i32(GROUP)) {
        let block = first + vec2<i32>(i % size.x, i / size.x);
        let index = block_index(vec2<u32>(block));
        if (atomicLoad(&blocks[index].entry) >= entry) { continue; }
        let middle = (vec2<f32>(block) + 0.5) * f32(1u << BLOCK_BITS);
        var outside = false;
        for (var side = 0u; side < 12u; side += 1u) {
            let line = sides[side];
            let reach = 0.5 * f32(1u << BLOCK_BITS) * (abs(line.x) + abs(line.y)) + SLACK;
            outside |= any(line.xy != vec2<f32>(0.0)) && dot(line.xy, middle) - line.z > reach;
        }
        if (!outside) { atomicMax(&blocks[index].entry, entry); }
    }
}
