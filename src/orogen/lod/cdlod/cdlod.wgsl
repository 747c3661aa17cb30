#include clipmap.wgsl
#include lod_vertex.wgsl
// Continuous distance-dependent level of detail (Houska 2019, section 2.3.8): from a vertex of a node to the morphed
// point. One grid serves all nodes; fully morphed ones take every second vertex of it (figure 2.31).

const THINNED_BIT = #{THINNED_BIT}u;   // of a vertex number: it belongs to the index list of every second vertex
const COARSER_BIT = #{COARSER_BIT}u;   // of a piece's edges: the first of four that mark coarser neighbours

struct Cdlod {
    grid_size: u32,         // quads along a node's side
    leaf: u32,              // subtexels along a quad of level 0
    top: u32,               // level of the single node that covers the data
    thinned: u32,           // first of the pieces that are drawn with every second vertex
    range: f32,             // metres at which level 0 ends; twice that for level 1 and so on
    morph_range: f32,       // last share of a level's range, in which its vertices move to those of the next level
    ground_bits: u32,       // cells of `ground` are 2^bits samples wide
    ground_columns: u32,
    eye_cell: vec2<i32>,    // the LOD eye: whole subtexels,
    eye_frac: vec2<f32>,    // their fraction
    eye_height: f32,        // and metres of the data
}

// A node, or with every second vertex the quadrant of a node of the next level.
struct Piece {
    x: u32,
    y: u32,
    level: u32,
    edges: u32,   // where levels meet: see seams.py
}

@group(1) @binding(0) var<uniform> cdlod: Cdlod;
@group(1) @binding(1) var<storage, read> pieces: array<Piece>;
@group(1) @binding(2) var<storage, read> ground: array<f32>;   // approximate heights at the corners of cells

fn quad_size(level: u32) -> i32 { return i32(cdlod.leaf << level); }

// Approximate height of a point with a whole position: the same whatever is resident.
fn ground_height(cell: vec2<i32>) -> f32 {
    let shift = frame.subtexel_bits + cdlod.ground_bits;
    let q = cell - frame.extent.xy;
    let columns = i32(cdlod.ground_columns);
    let last = vec2<i32>(columns, i32(arrayLength(&ground)) / columns) - 2;
    let at = clamp(q >> vec2<u32>(shift), vec2<i32>(0), last);
    let way = vec2<f32>(q - (at << vec2<u32>(shift))) * inverse_power(shift);
    let first = at.y * columns + at.x;
    return bilinear(ground[first], ground[first + 1], ground[first + columns], ground[first + columns + 1], way);
}

// Metres from the LOD eye to a point, its height included.
fn eye_distance(cell: vec2<i32>) -> f32 {
    let flat = to_metres(vec2<f32>(cell - cdlod.eye_cell) - cdlod.eye_frac);
    return length(vec3<f32>(flat, (ground_height(cell) - cdlod.eye_height) * frame.exaggeration));
}

// 0 where the level's own grid stands, 1 where it has become that of the next level (figure 2.30).
fn morph_factor(cell: vec2<i32>, level: u32) -> f32 {
    if (level == cdlod.top) { return 0.0; }
    let way = eye_distance(cell) / (cdlod.range * f32(1u << level));
    return clamp(1.0 - (1.0 - way) / cdlod.morph_range, 0.0, 1.0);
}

// The morph that both sides of an edge agree on where levels meet. `last`: of the rows and columns of the grid.
fn seam_morph(morph: f32, edges: u32, grid: vec2<u32>, last: u32) -> f32 {
    let lengthwise = grid.x == 0u || grid.x == last;
    if (!lengthwise && grid.y != 0u && grid.y != last) { return morph; }
    let edge = select(select(2u, 3u, grid.y == last), select(0u, 1u, grid.x == last), lengthwise);
    let quarter = 4u * select(grid.x, grid.y, lengthwise) / last;
    if ((edges >> (COARSER_BIT + edge) & 1u) == 1u) { return 1.0; }
    return select(morph, 0.0, (edges >> (4u * edge + quarter) & 1u) == 1u);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let thinned = vertex >> THINNED_BIT;
    let number = vertex & ((1u << THINNED_BIT) - 1u);
    let piece = pieces[instance + thinned * cdlod.thinned];
    let corner = frame.extent.xy + vec2<i32>(vec2<u32>(piece.x, piece.y) * cdlod.grid_size) * quad_size(piece.level);
    // every second vertex of a level is the grid of the next one
    let level = piece.level + thinned;
    let grid = vec2<u32>(number % (cdlod.grid_size + 1u), number / (cdlod.grid_size + 1u)) >> vec2<u32>(thinned);
    let quad = quad_size(level);
    let whole = corner + vec2<i32>(grid) * quad;
    let free = morph_factor(clamp_to_extent(Point(whole, vec2<f32>(0.0))).cell, level);
    let morph = seam_morph(free, piece.edges, grid, cdlod.grid_size >> thinned);
    let odd = vec2<i32>(grid & vec2<u32>(1u));
    var p = Point(whole, vec2<f32>(0.0));
    if (morph >= 1.0) {
        // in integers: these vertices coincide with those of the next level to the bit
        p.cell -= odd * quad;
    } else if (morph > 0.0) {
        let shift = morph * f32(quad) * vec2<f32>(odd);
        let steps = ceil(shift);
        p = Point(whole - vec2<i32>(steps), steps - shift);
    }
    p = clamp_to_extent(p);
    let id = (piece.level << 26u) ^ (piece.y << 13u) ^ piece.x;
    let lines = vec4<f32>(vec2<f32>(grid), f32(grid.x + grid.y), 0.5);
    return LodVertex(p, height_at(p), lines, id, drawn_level(p), level);
}
