#include clipmap.wgsl
// Persistent grid mapping (Houska 2019, chapter 3): from a place in the grid to a place on the ground plane.
//
// The grid is the unit square: u from left to right, v from near to far. The ground plane has the axes s, metres along
// the view direction, and l, metres to its right, from the foot of the LOD eye (outline.py). A row is a line of
// constant s; of it the grid covers what lies between the left and the right border of the outline.

const WARPING = #{WARPING}u;            // 0: rows as the auxiliary camera sees them, 1: by importance, 2: analytic
const TO_HULL = #{TAILORING}u == 2u;    // else the grid is a rectangle on the auxiliary camera's view plane
const TESSELLATION = #{TESSELLATION}u;  // 0: orthogonal, 1: symmetric, 2: diamond
const EDGE_SEARCH = #{EDGE_SEARCH};
const DIAMOND = TESSELLATION == 2u;
const GUARD = 1e-4;                     // of the distance: by this the grid is wider than the outline, for rounding
const IMAGE_COLUMNS = 8u;               // of the importance image (end of section 3.4)
const IMAGE_ROWS = 256u;

struct Pgm {
    columns: u32,               // cells along the grid's axes
    rows: u32,
    left_count: u32,            // points of the borders
    right_count: u32,
    along: vec2<f32>,           // (east, north) of the axis s
    ends: vec2<f32>,            // s of the first and the last row, where not beyond the outline
    depths: vec2<f32>,          // of those rows before the auxiliary camera
    slopes: vec2<f32>,          // l over depth of the first and the last column of a rectangle
    stretch: vec2<f32>,         // asinh(s / altitude) of the ends
    altitude: f32,              // of the LOD eye over the ground, metres
    cell_angle: f32,            // pixels of a column over pixels per radian
    edge_reach: f32,            // metres to which edges are searched
    left_data: u32,             // bits: pieces of the border that are a side of the data
    right_data: u32,
    padding: f32,
    borders: array<vec4<f32>, #{BORDER_POINTS}>,   // s and l of the left, s and l of the right border
}

struct Placed {
    cell: vec2<i32>,
    frac: vec2<f32>,
    height: f32,
    levels: u32,                // of the data and of the mesh (shifted by 8)
}

@group(1) @binding(0) var<uniform> pgm: Pgm;

// Cells from the left border to vertex i of row j. Odd rows of diamonds are shifted by half a cell (figure 3.8); at the
// borders there are half cells, so that these are straight.
fn place_in_row(i: u32, j: u32) -> f32 {
    if (!DIAMOND) { return f32(i); }
    return clamp(f32(i) - 0.5 + 0.5 * f32(j & 1u), 0.0, f32(pgm.columns) - 0.5);
}

fn guard(s: f32) -> f32 { return GUARD * (pgm.altitude + abs(s)); }
fn first_row() -> f32 { return pgm.borders[0].x; }
fn last_row() -> f32 { return pgm.borders[pgm.left_count - 1u].x; }

// Distance of the LOD eye from ground at (s, l).
fn eye_distance(s: f32, l: f32) -> f32 { return length(vec3<f32>(s, l, pgm.altitude)); }

// Number of the border's piece that a row lies on.
fn left_piece(s: f32) -> u32 {
    var k = 0u;
    while (k + 2u < pgm.left_count && s > pgm.borders[k + 1u].x) { k += 1u; }
    return k;
}

fn right_piece(s: f32) -> u32 {
    var k = 0u;
    while (k + 2u < pgm.right_count && s > pgm.borders[k + 1u].z) { k += 1u; }
    return k;
}

fn on_piece(a: vec2<f32>, b: vec2<f32>, s: f32) -> f32 { return a.y + (b.y - a.y) * ((s - a.x) / (b.x - a.x)); }
fn on_left(k: u32, s: f32) -> f32 { return on_piece(pgm.borders[k].xy, pgm.borders[k + 1u].xy, s); }
fn on_right(k: u32, s: f32) -> f32 { return on_piece(pgm.borders[k].zw, pgm.borders[k + 1u].zw, s); }

// The outline's borders at a row, l of the left and of the right one: what the redirection texture (section 3.3) holds.
fn borders_at(s: f32) -> vec2<f32> {
    let row = clamp(s, first_row(), last_row());
    return vec2<f32>(on_left(left_piece(row), row) - guard(row), on_right(right_piece(row), row) + guard(row));
}

// l of the first and the last column at a row.
fn columns_at(s: f32) -> vec2<f32> {
    if (TO_HULL) { return borders_at(s); }
    return pgm.slopes * mix(pgm.depths.x, pgm.depths.y, (s - pgm.ends.x) / (pgm.ends.y - pgm.ends.x));
}

fn lateral(u: f32, s: f32) -> f32 {
    let columns = columns_at(s);
    let l = columns.x + (columns.y - columns.x) * u;
    if (TO_HULL) { return l; }
    let border = borders_at(s);
    return clamp(l, border.x, border.y);
}

// Between two rows an edge of the mesh is straight where the outline has corners: so that it cuts none off, the ends of
// an edge lie on one of the lines that the outline follows between them. A side of the data is best: what overhangs it
// would be moved to it. Another line may lead far away where it runs along the row: then the outline's extreme takes
// its place. Here, the left border at row s, for the edge to row `other`.
fn left_of_edge(s: f32, other: f32) -> f32 {
    for (var k = left_piece(min(s, other)); k <= left_piece(max(s, other)); k += 1u) {
        if (((pgm.left_data >> k) & 1u) == 1u) { return on_left(k, s) - guard(s); }
    }
    let k = left_piece(0.5 * (s + other));
    var least = pgm.borders[0].y;
    for (var i = 1u; i < pgm.left_count; i += 1u) { least = min(least, pgm.borders[i].y); }
    let ends = min(on_left(k, s), on_left(k, other));
    return select(on_left(k, s), least, ends < least) - guard(s);
}

fn right_of_edge(s: f32, other: f32) -> f32 {
    for (var k = right_piece(min(s, other)); k <= right_piece(max(s, other)); k += 1u) {
        if (((pgm.right_data >> k) & 1u) == 1u) { return on_right(k, s) + guard(s); }
    }
    let k = right_piece(0.5 * (s + other));
    var most = pgm.borders[0].w;
    for (var i = 1u; i < pgm.right_count; i += 1u) { most = max(most, pgm.borders[i].w); }
    let ends = max(on_right(k, s), on_right(k, other));
    return select(on_right(k, s), most, ends > most) + guard(s);
}

// Row at a share t of the way from the near to the far end of the grid, before warping by importance.
fn unclipped_row(t: f32) -> f32 {
    if (WARPING == 0u) {
        // even on the auxiliary camera's view plane: equation 3.3, interpolated in perspective between the ends
        let weights = vec2<f32>(1.0 - t, t) / pgm.depths;
        return (pgm.ends.x * weights.x + pgm.ends.y * weights.y) / (weights.x + weights.y);
    }
    // ds proportional to the distance from the eye: rows that are as far apart as columns are, wherever those spread
    // with the distance. The closed form that section 5.1 asks for
    return pgm.altitude * sinh(mix(pgm.stretch.x, pgm.stretch.y, t));
}

fn base_row(t: f32) -> f32 {
    let first = first_row() - guard(first_row());
    let last = last_row() + guard(last_row());
    if (t <= 0.0) { return first; }
    if (t >= 1.0) { return last; }
    return clamp(unclipped_row(t), first, last);
}

// Camera-relative metres (east, north) of a place on the ground plane.
fn ground_at(s: f32, l: f32) -> vec2<f32> {
    return frame.lod_eye.xy + s * pgm.along + l * vec2<f32>(pgm.along.y, -pgm.along.x);
}
