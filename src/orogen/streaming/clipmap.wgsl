#include frame.wgsl
#include heightformat.wgsl
#include maxima_layout.wgsl
// The chunked clipmap (Kuehnert 2022, section 4.5): clipped quadtrees that find the best resident node of a position,
// and the node atlas that holds their texels. Heights are interpolated here from single texels: hardware filters weigh
// with 8 bits.

const NODE_BITS = #{NODE_BITS}u;       // nodes are 2^NODE_BITS texels wide (center_size)
const COVERED = #{COVERED};             // every texel is valid
const HEIGHT_BORDER = #{HEIGHT_BORDER};    // border_size of heights and coverage
const COLOR_BORDER = f32(#{COLOR_BORDER});
const MAX_ANISOTROPY = f32(#{MAX_ANISOTROPY});
const HEIGHT_SIZE = f32((1i << NODE_BITS) + 2 * HEIGHT_BORDER);
const COLOR_SIZE = f32(1u << NODE_BITS) + 2.0 * COLOR_BORDER;
const HEIGHTS = 0u;                 // index of a layer in `clipmap.layers`
const COLORS = 1u;
const NO_SLOT = 0xffffu;
const SOFTWARE = #{SOFTWARE};          // a software driver runs the shader (software.py)
const TABLE_WIDTH = #{TABLE_WIDTH}u;

struct Layer {
    level_count: u32,
    table_bits: u32,                // a level of the table has 2^bits nodes a side
    table_start: u32,
    present: u32,                   // 0: the terrain has no such layer, or nothing of it is resident yet
    reach: f32,                     // metres to which level 0 is used: view_distance * leaf node size
    blend_range: f32,               // share of a level's range over which it blends into the next
    subtexel_bits: u32,
    covered: u32,                   // 1: every texel is valid
    extent: vec4<i32>,              // first and last subtexel of the layer
    origins: array<vec4<i32>, 28>,  // per level: first node column and row of the window
}

struct ClipmapBlock {
    layers: array<Layer, 2>,
    color_matrix: vec4<f32>,        // height subtexels to colour subtexels, rows first
    color_anchor: vec2<i32>,        // colour subtexel of the frame's anchor
    color_offset: vec2<f32>,        // and its fraction
    sun_slope: vec2<f32>,           // what rays towards the sun rise per subtexel, metres of the data
    sun_rise: f32,                  // and per metre of their length, at least
    sun_ready: u32,                 // 1: the ceilings of all nodes in use are this sun's
}

struct SlotBounds { low: f32, high: f32, error: f32, level: f32 }

@group(0) @binding(1) var<uniform> #{CLIPMAP_BLOCK}: ClipmapBlock;
@group(0) @binding(2) var<storage, read> node_table: array<u32>;          // slot | level << 16 (table_entry)
@group(0) @binding(3) var<storage, read> node_bounds: array<vec2<f32>>;   // lowest and highest drawn height, per table entry
@group(0) @binding(4) var<storage, read> slot_bounds: array<SlotBounds>;
@group(0) @binding(5) var height_atlas: texture_2d_array<HeightTexel>;
@group(0) @binding(6) var coverage_atlas: texture_2d_array<f32>;
@group(0) @binding(7) var maxima_atlas: texture_2d_array<f32>;
@group(0) @binding(8) var color_atlas: texture_2d_array<f32>;
@group(0) @binding(9) var color_sampler: sampler;
@group(0) @binding(10) var texel_sampler: sampler;   // nearest: for gathers
@group(0) @binding(11) var ceilings_atlas: texture_2d_array<f32>;
@group(0) @binding(12) var sampled_tables: texture_2d_array<f32>;         // node_table, and low and high of its slots

struct Node {
    slot: u32,
    level: u32,          // of the data; at least the level asked for
    cell: vec2<i32>,     // column and row of the data's node in its level
    asked: u32,          // the level whose node was looked up: the asked one, or the finest whose window reaches here
}

struct Blend { level: u32, ratio: f32 }

// Levels that a blend needs. Asked of a loop, never of a branch: software drivers run both sides of every branch, but end
// a loop when no lane needs another turn.
fn levels_of(blend: Blend) -> u32 { return select(2u, 1u, blend.ratio >= 1.0); }

// 2^-n, exactly (exp2 may round).
fn inverse_power(n: u32) -> f32 { return bitcast<f32>((127u - n) << 23u); }

fn table_index(layer: u32, node: vec2<i32>, level: u32) -> u32 {
    let bits = clipmap.layers[layer].table_bits;
    let wrapped = vec2<u32>(node) & vec2<u32>((1u << bits) - 1u);
    return clipmap.layers[layer].table_start + (((level << bits) | wrapped.y) << bits | wrapped.x);
}

// The finest level, not below `level`, whose window holds the cell.
fn windowed_level(layer: u32, cell: vec2<i32>, level: u32) -> u32 {
    let side = 1i << clipmap.layers[layer].table_bits;
    let last = clipmap.layers[layer].level_count - 1u;
    var l = min(level, last);
    loop {
        if (l >= last) { break; }
        let node = cell >> vec2<u32>(clipmap.layers[layer].subtexel_bits + NODE_BITS + l);
        // of the block itself, never of a copy: that of an array which is indexed would lie in memory
        let inside = node - #{CLIPMAP_BLOCK}.layers[layer].origins[l].xy;
        if (all(inside >= vec2<i32>(0)) && all(inside < vec2<i32>(side))) { break; }
        l += 1u;
    }
    return l;
}

// Software drivers read buffers, and the size of a texture's level, once for each lane; a sample at a level that is known
// beforehand they take for all at once.
fn sampled_table(index: u32, part: i32) -> f32 {
    let place = vec2<f32>(vec2<u32>(index % TABLE_WIDTH, index / TABLE_WIDTH)) + 0.5;
    let size = vec2<f32>(textureDimensions(sampled_tables));
    return textureSampleLevel(sampled_tables, texel_sampler, place / size, part, 0.0).x;
}

fn table_entry(index: u32) -> u32 {
    if (SOFTWARE) { return u32(sampled_table(index, 0)); }
    return node_table[index];
}

// Lowest and highest texel of the node of heights that was looked up for a cell.
fn texel_range(cell: vec2<i32>, node: Node) -> vec2<f32> {
    if (SOFTWARE) {
        let index = table_index(HEIGHTS, cell >> vec2<u32>(frame.subtexel_bits + NODE_BITS + node.asked), node.asked);
        return vec2<f32>(sampled_table(index, 1), sampled_table(index, 2));
    }
    let bounds = slot_bounds[node.slot];
    return vec2<f32>(bounds.low, bounds.high);
}

fn lookup(layer: u32, cell: vec2<i32>, level: u32) -> Node {
    let l = windowed_level(layer, cell, level);
    let shift = clipmap.layers[layer].subtexel_bits + NODE_BITS;
    let entry = table_entry(table_index(layer, cell >> vec2<u32>(shift + l), l));
    let found = (entry >> 16u) & 0xffu;
    return Node(entry & 0xffffu, found, cell >> vec2<u32>(shift + found), l);
}

// Continuous level of detail from the distance (equation 4.9).
fn distance_level(layer: u32, distance: f32) -> f32 {
    let top = f32(clipmap.layers[layer].level_count - 1u);
    return min(log2(max(2.0 * distance / clipmap.layers[layer].reach, 1.0)), top);
}

fn blend_at(layer: u32, flat: vec2<f32>) -> Blend {
    let level = distance_level(layer, lod_distance(flat));
    let whole = floor(level);
    return Blend(u32(whole), clamp((1.0 - (level - whole)) / clipmap.layers[layer].blend_range, 0.0, 1.0));
}

fn lod_at(p: Point) -> f32 {
    return distance_level(HEIGHTS, lod_distance(flat_position(p)));
}

// Texel whose centre lies at or before the point in both axes, relative to the node's first one, and the way to the next.
struct Texel { at: vec2<i32>, way: vec2<f32> }

fn texel_of(p: Point, node: Node, subtexel_bits: u32) -> Texel {
    let shift = subtexel_bits + node.level;
    let q = p.cell - (1i << (shift - 1u));
    let base = q >> vec2<u32>(shift);
    let way = (vec2<f32>(q - (base << vec2<u32>(shift))) + p.frac) * inverse_power(shift);
    return Texel(base - (node.cell << vec2<u32>(NODE_BITS)), way);
}

fn height_texel(slot: u32, at: vec2<i32>) -> f32 {
    return height_of(textureLoad(height_atlas, at + HEIGHT_BORDER, i32(slot), 0).x);
}

// An entry of a node's maximum pyramid.
fn maximum_texel(slot: u32, level: u32, entry: vec2<i32>) -> f32 {
    let place = maxima_place(level, entry);
    if (!SOFTWARE) { return textureLoad(maxima_atlas, place, i32(slot), 0).x; }
    let at = (vec2<f32>(place) + 0.5) / vec2<f32>(MAXIMA_SIZE);
    return textureSampleLevel(maxima_atlas, texel_sampler, at, i32(slot), 0.0).x;
}

// The texels at `at`, right of it, below it, and diagonally: one gather, aimed at the corner that they share.
fn height_quad(slot: u32, at: vec2<i32>) -> vec4<f32> {
    let corner = (vec2<f32>(at + HEIGHT_BORDER) + 1.0) / HEIGHT_SIZE;
    return heights_of(textureGather(0, height_atlas, texel_sampler, corner, i32(slot)).wzxy);
}

fn bilinear(h00: f32, h10: f32, h01: f32, h11: f32, way: vec2<f32>) -> f32 {
    let top = h00 + (h10 - h00) * way.x;
    let bottom = h01 + (h11 - h01) * way.x;
    return top + (bottom - top) * way.y;
}

fn node_height(p: Point, node: Node) -> f32 {
    let t = texel_of(p, node, frame.subtexel_bits);
    let texels = height_quad(node.slot, t.at);
    let h = bilinear(texels.x, texels.y, texels.z, texels.w, t.way);
    return clamp(h, frame.height_min, frame.height_max);
}

fn height_at_level(p: Point, level: u32) -> f32 {
    return node_height(p, lookup(HEIGHTS, p.cell, level));
}

fn resident_level(p: Point, level: u32) -> u32 {
    return lookup(HEIGHTS, p.cell, level).level;
}

// Height in metres of the data, blended between two levels near the end of a level's range (section 4.5.5).
fn height_at(p: Point) -> f32 {
    let blend = blend_at(HEIGHTS, flat_position(p));
    var height = 0.0;
    for (var k = 0u; k < levels_of(blend); k += 1u) {
        let next = height_at_level(p, blend.level + k);
        height = next + (height - next) * select(0.0, blend.ratio, k > 0u);
    }
    return height;
}

// Stored bound (metres of the data) on the distance between the nodes that height_at uses and the level-0 surface.
fn error_at(p: Point) -> f32 {
    let blend = blend_at(HEIGHTS, flat_position(p));
    let fine = slot_bounds[lookup(HEIGHTS, p.cell, blend.level).slot].error;
    if (blend.ratio >= 1.0) { return fine; }
    let coarse = slot_bounds[lookup(HEIGHTS, p.cell, blend.level + 1u).slot].error;
    return coarse + (fine - coarse) * blend.ratio;
}

fn node_coverage(p: Point, node: Node) -> f32 {
    let t = texel_of(p, node, frame.subtexel_bits);
    let at = t.at + HEIGHT_BORDER;
    let slot = i32(node.slot);
    return bilinear(
        textureLoad(coverage_atlas, at, slot, 0).x, textureLoad(coverage_atlas, at + vec2<i32>(1, 0), slot, 0).x,
        textureLoad(coverage_atlas, at + vec2<i32>(0, 1), slot, 0).x, textureLoad(coverage_atlas, at + vec2<i32>(1, 1), slot, 0).x,
        t.way);
}

// 1 where the data is valid, 0 where it is not, in between at the border: drawn from one half on.
fn coverage_at(p: Point) -> f32 {
    if (clipmap.layers[HEIGHTS].present == 0u) { return 0.0; }
    if (COVERED) { return 1.0; }
    let blend = blend_at(HEIGHTS, flat_position(p));
    var cover = 0.0;
    for (var k = 0u; k < levels_of(blend); k += 1u) {
        let next = node_coverage(p, lookup(HEIGHTS, p.cell, blend.level + k));
        cover = next + (cover - next) * select(0.0, blend.ratio, k > 0u);
    }
    return cover;
}

// Slope of one node in metres per texel of its level: central differences over two texels.
fn node_slope(p: Point, node: Node) -> vec2<f32> {
    let t = texel_of(p, node, frame.subtexel_bits);
    let a = height_quad(node.slot, t.at - 1);
    let b = height_quad(node.slot, t.at + vec2<i32>(1, -1));
    let c = height_quad(node.slot, t.at + vec2<i32>(-1, 1));
    let d = height_quad(node.slot, t.at + 1);
    let upper = mix(vec2<f32>(a.y, b.x), vec2<f32>(a.w, b.z), t.way.y);
    let lower = mix(vec2<f32>(c.y, d.x), vec2<f32>(c.w, d.z), t.way.y);
    let middle = mix(vec4<f32>(a.zw, b.zw), vec4<f32>(c.xy, d.xy), t.way.y);
    let along_x = mix(middle.z - middle.x, middle.w - middle.y, t.way.x);
    let along_y = mix(lower.x - upper.x, lower.y - upper.y, t.way.x);
    return vec2<f32>(along_x, along_y) * 0.5;
}

fn level_gradient(p: Point, level: u32) -> vec2<f32> {
    let node = lookup(HEIGHTS, p.cell, level);
    let slope = node_slope(p, node) * inverse_power(frame.subtexel_bits + node.level);
    // covector: metres per subtexel to metres per metre is the transpose of the inverse
    return vec2<f32>(dot(frame.subtexels.xz, slope), dot(frame.subtexels.yw, slope)) * frame.exaggeration;
}

// d height / d (east, north) of the drawn surface, at a continuous level.
fn gradient_at(p: Point, lod: f32) -> vec2<f32> {
    let level = clamp(lod, 0.0, f32(clipmap.layers[HEIGHTS].level_count - 1u));
    let whole = floor(level);
    let ratio = clamp((1.0 - (level - whole)) / clipmap.layers[HEIGHTS].blend_range, 0.0, 1.0);
    let blend = Blend(u32(whole), ratio);
    var gradient = vec2<f32>(0.0);
    for (var k = 0u; k < levels_of(blend); k += 1u) {
        gradient = mix(level_gradient(p, blend.level + k), gradient, select(0.0, ratio, k > 0u));
    }
    return gradient;
}

// Lowest and highest drawn height (metres of the data) over a rectangle of subtexels that is no wider than a node of
// `level`; conservative where the windows end.
fn bounds_over(low: vec2<i32>, high: vec2<i32>, level: u32) -> vec2<f32> {
    let first = clamp(low, frame.extent.xy, frame.extent.zw);
    let last = clamp(high, frame.extent.xy, frame.extent.zw);
    let l = max(windowed_level(HEIGHTS, first, level), windowed_level(HEIGHTS, last, level));
    let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + l);
    let a = first >> shift;
    let b = last >> shift;
    var bounds = vec2<f32>(1e30, -1e30);
    for (var y = a.y; y <= b.y; y += 1) {
        for (var x = a.x; x <= b.x; x += 1) {
            let node = node_bounds[table_index(HEIGHTS, vec2<i32>(x, y), l)];
            bounds = vec2<f32>(min(bounds.x, node.x), max(bounds.y, node.y));
        }
    }
    return bounds;
}

// Lengths of the longer and the shorter axis of the ellipse that a matrix makes of the unit circle, and the direction of
// the longer one.
struct Ellipse { major: f32, minor: f32, along: vec2<f32> }

fn ellipse_of(m: mat2x2<f32>) -> Ellipse {
    let p = m[0].x * m[0].x + m[1].x * m[1].x;
    let q = m[0].x * m[0].y + m[1].x * m[1].y;
    let r = m[0].y * m[0].y + m[1].y * m[1].y;
    let middle = 0.5 * (p + r);
    let half = 0.5 * abs(p - r);
    let spread = sqrt(half * half + q * q);
    let along = select(vec2<f32>(q, half + spread), vec2<f32>(half + spread, q), p >= r);
    return Ellipse(sqrt(middle + spread), sqrt(max(middle - spread, 0.0)), along / max(length(along), 1e-30));
}

// Anisotropic filtering: trilinear samples along the longer axis of the footprint, as wide as the shorter one. Not left
// to the sampler, since software drivers filter neighbouring invocations as one.
fn node_color(p: Point, node: Node, footprint: mat2x2<f32>) -> vec4<f32> {
    let shift = clipmap.layers[COLORS].subtexel_bits + node.level;
    let inside = p.cell - (node.cell << vec2<u32>(shift + NODE_BITS));
    let at = ((vec2<f32>(inside) + p.frac) * inverse_power(shift) + COLOR_BORDER) / COLOR_SIZE;
    let axes = ellipse_of(footprint * inverse_power(shift));
    let width = max(max(axes.minor, axes.major / MAX_ANISOTROPY), 1.0);
    let count = clamp(ceil(axes.major / width), 1.0, MAX_ANISOTROPY);
    let step = axes.along * (axes.major / (count * COLOR_SIZE));
    var sum = vec4<f32>(0.0);
    for (var i = 0.5; i < count; i += 1.0) {
        sum += textureSampleLevel(color_atlas, color_sampler, at + (i - 0.5 * count) * step, i32(node.slot), log2(width));
    }
    return sum / count;
}

// The draped image: linear RGB and alpha; alpha is 0 outside. Footprint columns: height subtexels per pixel step.
fn color_at(p: Point, footprint: mat2x2<f32>) -> vec4<f32> {
    if (clipmap.layers[COLORS].present == 0u) { return vec4<f32>(0.0); }
    let m = mat2x2<f32>(clipmap.color_matrix.xz, clipmap.color_matrix.yw);
    let offset = m * (vec2<f32>(p.cell - frame.anchor) + p.frac) + clipmap.color_offset;
    let whole = floor(offset);
    let q = Point(clipmap.color_anchor + vec2<i32>(whole), offset - whole);
    let extent = clipmap.layers[COLORS].extent;
    if (any(q.cell < extent.xy) || any(q.cell >= extent.zw)) { return vec4<f32>(0.0); }
    let blend = blend_at(COLORS, flat_position(p));
    var color = vec4<f32>(0.0);
    for (var k = 0u; k < levels_of(blend); k += 1u) {
        let next = node_color(q, lookup(COLORS, q.cell, blend.level + k), m * footprint);
        color = mix(next, color, select(0.0, blend.ratio, k > 0u));
    }
    // stored with the alpha multiplied in, so that what is transparent does not colour what is beside it
    return vec4<f32>(color.rgb / max(color.a, 1e-6), color.a);
}
