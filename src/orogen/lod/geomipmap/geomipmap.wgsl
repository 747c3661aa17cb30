#include clipmap.wgsl
#include lod_vertex.wgsl
// Geometrical mipmapping (de Boer 2000; Kuehnert 2022, section 3.2): from a vertex of a block to its place and height,
// on the way from its level to the next.

const SIDE = #{SIDE}u;                          // quads along a block at level 0
const UNIT_BITS = #{UNIT_BITS}u;                // such a quad is 2^bits subtexels wide
const LISTS = #{LISTS}u;                        // index lists of a level
const COUNT = #{COUNT}u;                        // and of all
const LIST_BIT = #{LIST_BIT}u;                  // fields of a vertex number, see patterns.py
const NO_ROWS_BIT = #{NO_ROWS_BIT}u;
const NO_COLUMNS_BIT = #{NO_COLUMNS_BIT}u;

struct Block {
    x: u32,
    y: u32,
    thinned: u32,         // bits of the west, east, north and south edge: every second vertex is left out
    morph: f32,           // 0 where the level's own mesh stands, 1 where it has become that of the next level
    edges: vec4<f32>,     // the same for the vertices on its west, east, north and south edge
}

@group(1) @binding(0) var<uniform> starts: array<vec4<u32>, COUNT>;   // first block of each list
@group(1) @binding(1) var<storage, read> blocks: array<Block>;

fn cell_of(block: Block, at: vec2<i32>) -> vec2<i32> {
    return frame.extent.xy + ((vec2<i32>(vec2<u32>(block.x, block.y) * SIDE) + at) << vec2<u32>(UNIT_BITS));
}

// A height is a mean of those at some vertices, which are gathered first: fetched in one place, they keep shaders small.
struct Part { at: vec2<i32>, weight: f32 }
var<private> parts: array<Part, 9>;
var<private> part_count: u32;

fn add_part(at: vec2<i32>, weight: f32) {
    parts[part_count] = Part(at, weight);
    part_count += 1u;
}

// Weighted mean of the parts' heights. Past the data's rim the surface is turned about the rim, so that planes go on;
// only what is inside is drawn.
fn mean_height(block: Block) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < 2u * part_count; i += 1u) {
        let part = parts[i >> 1u];
        let cell = cell_of(block, part.at);
        let rim = clamp(cell, frame.extent.xy, frame.extent.zw);
        let past = any(rim != cell);
        let back = (i & 1u) == 1u;
        if (back && !past) { continue; }
        let there = select(rim, clamp(2 * rim - cell, frame.extent.xy, frame.extent.zw), back);
        let weight = select(select(1.0, 2.0, past), -1.0, back);
        sum += part.weight * weight * height_at(Point(there, vec2<f32>(0.0)));
    }
    return sum;
}

fn on_edge(at: vec2<i32>) -> bool { return any(at == vec2<i32>(0)) || any(at == vec2<i32>(i32(SIDE))); }

// Move a vertex on an edge, of whose height a share counts, towards the next coarser level of the edge; both sides alike.
fn move_on_edge(block: Block, at: vec2<i32>, level: u32, share: f32) {
    let lengthwise = at.x == 0 || at.x == i32(SIDE);
    let edge = select(select(2u, 3u, at.y == i32(SIDE)), select(0u, 1u, at.x == i32(SIDE)), lengthwise);
    // a thinned edge is one of the next level already
    let quad = 1 << (level + (block.thinned >> edge & 1u));
    let odd = ((select(at.x, at.y, lengthwise) / quad) & 1) == 1;
    let morph = select(0.0, block.edges[edge], odd);
    add_part(at, share * (1.0 - morph));
    if (morph > 0.0) {
        let step = select(vec2<i32>(quad, 0), vec2<i32>(0, quad), lengthwise);
        add_part(at - step, 0.5 * share * morph);
        add_part(at + step, 0.5 * share * morph);
    }
}

// An end of the line that a vertex inside moves to. Where that end lies on an edge it moves as far as the edge does.
fn add_end(block: Block, at: vec2<i32>, level: u32) {
    if (on_edge(at)) {
        move_on_edge(block, at, level, 0.5);
        add_part(at, 0.5 * (block.morph - 1.0));
    } else {
        add_part(at, 0.5 * block.morph);
    }
}

// Move a vertex inside that lies between two vertices of the next level towards their middle.
fn move_inside(block: Block, at: vec2<i32>, level: u32) {
    let odd = (at >> vec2<u32>(level)) & vec2<i32>(1);
    if (all(odd == vec2<i32>(0)) || block.morph == 0.0) {
        add_part(at, 1.0);
        return;
    }
    var step = odd << vec2<u32>(level);
    // middles of fans: along the diagonal of the next level, which runs to the middle of its own fan
    let parent = at >> vec2<u32>(level + 1u);
    if (all(odd == vec2<i32>(1)) && ((parent.x + parent.y) & 1) == 1) { step.y = -step.y; }
    add_part(at, 1.0 - block.morph);
    add_end(block, at - step, level);
    add_end(block, at + step, level);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let list = vertex >> LIST_BIT;
    let number = vertex & ((1u << NO_COLUMNS_BIT) - 1u);
    let level = list / LISTS;
    let block = blocks[starts[list].x + instance];
    let at = vec2<i32>(vec2<u32>(number % (SIDE + 1u), number / (SIDE + 1u)));
    part_count = 0u;
    if (on_edge(at)) { move_on_edge(block, at, level, 1.0); } else { move_inside(block, at, level); }
    let height = mean_height(block);
    let cell = cell_of(block, at);
    let p = Point(cell, vec2<f32>(0.0));
    let place = vec2<f32>(at) * inverse_power(level);
    var lines = vec4<f32>(place, 0.5 * (place.x + place.y), 0.5 * (place.x - place.y));
    if ((vertex >> NO_COLUMNS_BIT & 1u) == 1u) { lines.x = 0.5; }
    if ((vertex >> NO_ROWS_BIT & 1u) == 1u) { lines.y = 0.5; }
    let id = (level << 26u) ^ (block.y << 13u) ^ block.x;
    return LodVertex(p, height, lines, id, resident_level(clamp_to_extent(p), u32(lod_at(p))), level);
}
