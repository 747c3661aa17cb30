#include lattice.wgsl
#include frustum.wgsl
#include state.wgsl
// Pass 1, pattern selection: edges decide how often they are halved, a triangle's three edges are its pattern.

const PIXELS = f32(#{PIXELS});              // length of a triangle's edge at most, seen face on

@group(1) @binding(0) var<storage, read_write> state: State;
@group(1) @binding(1) var<storage, read_write> edges: array<u32>;
@group(1) @binding(2) var<storage, read_write> coarse: array<Coarse>;
@group(1) @binding(3) var<storage, read> pattern_table: array<vec2<u32>>;

const EAST = 0u;
const SOUTH = 1u;
const DIAGONAL = 2u;
const EAST_EDGES = COLUMNS * (ROWS + 1u);
const SOUTH_EDGES = (COLUMNS + 1u) * ROWS;
const EDGES = EAST_EDGES + SOUTH_EDGES + COLUMNS * ROWS;

// An edge by the upper left end of it and the direction that it runs in.
struct Edge { kind: u32, place: vec2<u32> }

fn edge_number(kind: u32, place: vec2<u32>) -> u32 {
    if (kind == EAST) { return place.y * COLUMNS + place.x; }
    if (kind == SOUTH) { return EAST_EDGES + place.y * (COLUMNS + 1u) + place.x; }
    return EAST_EDGES + SOUTH_EDGES + place.y * COLUMNS + place.x;
}

fn edge_of(number: u32) -> Edge {
    var kind = EAST;
    var within = number;
    if (number >= EAST_EDGES + SOUTH_EDGES) {
        kind = DIAGONAL;
        within -= EAST_EDGES + SOUTH_EDGES;
    } else if (number >= EAST_EDGES) {
        kind = SOUTH;
        within -= EAST_EDGES;
    }
    let columns = select(COLUMNS, COLUMNS + 1u, kind == SOUTH);
    return Edge(kind, vec2<u32>(within % columns, within / columns));
}

fn drawn_at(cell: vec2<i32>) -> vec3<f32> {
    let p = Point(cell, vec2<f32>(0.0));
    return lift(flat_position(p), height_at(p));
}

fn drawn_vertex(place: vec2<i32>) -> vec3<f32> {
    return drawn_at(lattice_vertex(vec2<u32>(clamp(place, vec2<i32>(0), vec2<i32>(i32(COLUMNS), i32(ROWS))))));
}

// Halvings after which an edge's parts are no longer than PIXELS, seen face on from where the LOD camera is nearest to
// either of its triangles: what lies inside these has only their edges to speak for it.
fn edge_depth(edge: Edge) -> u32 {
    let at = vec2<i32>(edge.place);
    // from the first end to the second, and to the third corners of the two triangles
    var along = vec2<i32>(1, 1);
    var left = vec2<i32>(1, 0);
    var right = vec2<i32>(0, 1);
    if (edge.kind == EAST) {
        along = vec2<i32>(1, 0);
        left = vec2<i32>(0, -1);
        right = vec2<i32>(1, 1);
    } else if (edge.kind == SOUTH) {
        along = vec2<i32>(0, 1);
        left = vec2<i32>(-1, 0);
        right = vec2<i32>(1, 1);
    }
    let first = lattice_vertex(vec2<u32>(at));
    let last = lattice_vertex(vec2<u32>(at + along));
    let a = drawn_at(first);
    let middle = drawn_at(first + (last - first) / 2);
    let b = drawn_at(last);
    let c = drawn_vertex(at + left);
    let d = drawn_vertex(at + right);
    let low = min(min(min(a, b), min(c, d)), middle);
    let high = max(max(max(a, b), max(c, d)), middle);
    let away = length(max(max(low - frame.lod_eye, frame.lod_eye - high), vec3<f32>(0.0)));
    // over the middle, so that an edge over a ridge is as long as it looks; metres to pixels: Houska 2019, equation 2.3
    let size = (distance(a, middle) + distance(middle, b)) * frame.lod_pixels_per_radian;
    var depth = 0u;
    while (depth < DEPTH && size > PIXELS * f32(1u << depth) * away) { depth += 1u; }
    return depth;
}

// Each edge decides once, for both triangles that share it.
@compute @workgroup_size(#{GROUP})
fn measure_edges(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x == 0u) {
        for (var i = 0u; i < 8u; i += 1u) { atomicStore(&state.totals[i], 0u); }
        state.present = clipmap.layers[HEIGHTS].present;
    }
    if (id.x >= EDGES || clipmap.layers[HEIGHTS].present == 0u) { return; }
    edges[id.x] = edge_depth(edge_of(id.x));
}

// Whether all that is drawn over a triangle lies outside one of the frustum's planes.
fn is_outside(corners: Corners) -> bool {
    let a = flat_position(Point(corners.a, vec2<f32>(0.0)));
    let b = flat_position(Point(corners.b, vec2<f32>(0.0)));
    let c = flat_position(Point(corners.c, vec2<f32>(0.0)));
    return prism_outside(a, b, c, c, bounds_around(min(corners.a, corners.b), max(corners.a, corners.b)));
}

// Depths of the edges opposite a, b and c.
fn depths_of(number: u32) -> vec3<u32> {
    let cell = vec2<u32>(number / 2u % COLUMNS, number / 2u / COLUMNS);
    let lower = number % 2u;
    let side = edges[edge_number(SOUTH, cell + vec2<u32>(1u - lower, 0u))];
    let level = edges[edge_number(EAST, cell + vec2<u32>(0u, lower))];
    return vec3<u32>(side, level, edges[edge_number(DIAGONAL, cell)]);
}

var<workgroup> sums: array<atomic<u32>, 8>;

@compute @workgroup_size(#{GROUP})
fn select_patterns(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if (thread <= DEPTH) { atomicStore(&sums[thread], 0u); }
    workgroupBarrier();
    var depths = vec3<u32>(0u);
    if (id.x < COARSE) {
        // triangles out of sight are kept, as they are: nothing would be left to refine them from
        if (clipmap.layers[HEIGHTS].present != 0u && !is_outside(coarse_corners(id.x))) { depths = depths_of(id.x); }
        coarse[id.x].depths = packed(depths);
        for (var bias = 0u; bias <= DEPTH; bias += 1u) {
            atomicAdd(&sums[bias], pattern_table[pattern_number(packed(depths), bias)].y);
        }
    }
    workgroupBarrier();
    if (thread <= DEPTH) { atomicAdd(&state.totals[thread], atomicLoad(&sums[thread])); }
}
