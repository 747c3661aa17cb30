#include pgm.wgsl
// The grid's vertices: placed on the ground plane, moved to terrain edges and onto the data, displaced.

@group(1) @binding(1) var<storage, read> integrals: array<f32>;
@group(1) @binding(2) var<storage, read_write> placed: array<Placed>;

const EDGE_STEPS = 8u;       // places between two vertices that are looked at for an edge
const EDGE_HALVINGS = 6u;    // of the interval around the edge
const SLOPE_STEP = 0.1;      // of a cell's height: epsilon of section 3.5

// The integral of the importance along the column u, normalised, at row k of the image.
fn integral(u: f32, k: u32) -> f32 {
    let at = clamp(u, 0.0, 1.0) * f32(IMAGE_COLUMNS - 1u);
    let column = min(u32(at), IMAGE_COLUMNS - 2u);
    let start = column * (IMAGE_ROWS + 1u) + k;
    return mix(integrals[start], integrals[start + IMAGE_ROWS + 1u], at - f32(column));
}

// The integral's inverse, by bisection (figure 3.20 e).
fn warped(u: f32, v: f32) -> f32 {
    var k = 0u;
    for (var bit = IMAGE_ROWS / 2u; bit > 0u; bit /= 2u) {
        if (integral(u, k + bit) <= v) { k += bit; }
    }
    let low = integral(u, k);
    let high = integral(u, k + 1u);
    return (f32(k) + clamp((v - low) / max(high - low, 1e-30), 0.0, 1.0)) / f32(IMAGE_ROWS);
}

// Row of the grid's vertices j in the column u.
fn row_of(u: f32, j: i32) -> f32 {
    let v = clamp(f32(j) / f32(pgm.rows), 0.0, 1.0);
    if (WARPING != 1u || v <= 0.0 || v >= 1.0) { return base_row(v); }
    return base_row(warped(u, v));
}

fn column_of(i: u32, j: u32) -> f32 { return place_in_row(i, j) / place_in_row(pgm.columns, 0u); }

fn point_on(s: f32, l: f32) -> Point {
    return clamp_to_extent(point_at(to_subtexels(ground_at(s, l)) + frame.eye_offset));
}

// Height in metres of the data at a continuous level.
fn height_at_lod(p: Point, lod: f32) -> f32 {
    let whole = floor(lod);
    let fine = height_at_level(p, u32(whole));
    if (lod == whole) { return fine; }
    return mix(fine, height_at_level(p, u32(whole) + 1u), lod - whole);
}

// The level at which height_at blends.
fn data_lod(p: Point) -> f32 {
    let blend = blend_at(HEIGHTS, flat_position(p));
    return f32(blend.level) + 1.0 - blend.ratio;
}

fn height_on(u: f32, s: f32, lod: f32) -> f32 { return height_at_lod(point_on(s, lateral(u, s)), lod); }

// The terrain edge that lies between a vertex's row and the one before it, else the row (section 3.5).
fn row_of_edge(u: f32, before: f32, row: f32, after: f32, lod: f32) -> f32 {
    let rise = height_on(u, before + SLOPE_STEP * (row - before), lod) - height_on(u, before, lod);
    let fall = height_on(u, row + SLOPE_STEP * (after - row), lod) - height_on(u, row, lod);
    if (rise <= 0.0 || fall >= 0.0) { return row; }
    let step = (row - before) / f32(EDGE_STEPS);
    var last = height_on(u, before, lod);
    var high = row;
    for (var k = 1u; k <= EDGE_STEPS; k += 1u) {
        let s = before + f32(k) * step;
        let h = height_on(u, s, lod);
        if (h < last) {
            high = s;
            break;
        }
        last = h;
    }
    // the last step crossed the edge, or the one before it did
    var low = max(high - 2.0 * step, before);
    for (var k = 0u; k < EDGE_HALVINGS; k += 1u) {
        let middle = 0.5 * (low + high);
        let rises = height_on(u, middle + SLOPE_STEP * (high - middle), lod) > height_on(u, middle, lod);
        low = select(low, middle, rises);
        high = select(middle, high, rises);
    }
    return 0.5 * (low + high);
}

// The mip level of a cell's longer side (section 3.4), 0 or more.
fn footprint_lod(u: f32, before: f32, row: f32, after: f32, steps: f32) -> f32 {
    let columns = columns_at(row);
    let width = (columns.y - columns.x) / f32(pgm.columns);
    let height = distance(vec2<f32>(before, lateral(u, before)), vec2<f32>(after, lateral(u, after))) / steps;
    return log2(max(max(width, height) / frame.spacing, 1.0));
}

@compute @workgroup_size(8, 8)
fn place_vertices(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    let j = id.y;
    if (i > pgm.columns || j > pgm.rows) { return; }
    let u = column_of(i, j);
    let before = row_of(u, i32(j) - 1);
    let row = row_of(u, i32(j));
    let after = row_of(u, i32(j) + 1);
    var s = row;
    var l = lateral(u, row);

    let footprint = footprint_lod(u, before, row, after, select(2.0, 1.0, j == 0u || j == pgm.rows));
    let top = f32(clipmap.layers[HEIGHTS].level_count - 1u);
    let lod = min(max(footprint, data_lod(point_on(s, l))), top);

    if (i == 0u) {
        l = min(l, min(left_of_edge(row, before), left_of_edge(row, after)));
    } else if (i == pgm.columns) {
        l = max(l, max(right_of_edge(row, before), right_of_edge(row, after)));
    } else if (EDGE_SEARCH && j > 0u && j < pgm.rows && eye_distance(s, l) < pgm.edge_reach) {
        s = row_of_edge(u, before, row, after, lod);
        l = lateral(u, s);
    }
    let p = point_on(s, l);
    let level = resident_level(p, u32(lod));
    placed[j * (pgm.columns + 1u) + i] = Placed(p.cell, p.frac, height_at_lod(p, lod), level | (u32(footprint) << 8u));
}
