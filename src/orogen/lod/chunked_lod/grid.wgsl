#include clipmap.wgsl
#include lod_vertex.wgsl
#include skirt.wgsl
// Chunks as regular grids that take their heights from the node atlas (Vistnes 2006), with skirts.

const SIDE = #{SIDE}u;      // quads along a chunk

struct Grid {
    corner: vec2<i32>,      // subtexels
    quad: i32,              // subtexels
    sides: u32,             // bits of the sides that lie inside the raster: west, east, north, south
    id: u32,
    tile_level: u32,
}

@group(1) @binding(0) var<storage, read> grids: array<Grid>;

fn vertex_place(grid: Grid, at: vec2<i32>) -> Point {
    return clamp_to_extent(Point(grid.corner + at * grid.quad, vec2<f32>(0.0)));
}

// By how much a straight edge from a to b passes over the ground at a point on it.
fn over(a: Point, b: Point, height_a: f32, height_b: f32, p: Point) -> f32 {
    let whole = vec2<f32>(b.cell - a.cell);
    let part = vec2<f32>(p.cell - a.cell);
    let way = max(abs(part.x), abs(part.y)) / max(max(abs(whole.x), abs(whole.y)), 1.0);
    return height_a + (height_b - height_a) * way - height_at(p);
}

// How deep a skirt must hang from a vertex so that it reaches the edge of a neighbour whose quads are twice or half as
// wide; chunks that touch differ by no more.
fn drop_at(grid: Grid, at: vec2<i32>, along: vec2<i32>, height: f32) -> f32 {
    let p = vertex_place(grid, at);
    var drop = 0.0;
    let before = vertex_place(grid, at - along);
    let after = vertex_place(grid, at + along);
    let height_before = height_at(before);
    let height_after = height_at(after);
    let odd = (dot(at, along) & 1) == 1;
    if (odd) { drop = max(drop, -over(before, after, height_before, height_after, p)); }
    if (grid.quad > 1) {
        let half = along * (grid.quad / 2);
        let middle_before = clamp_to_extent(Point(grid.corner + at * grid.quad - half, vec2<f32>(0.0)));
        let middle_after = clamp_to_extent(Point(grid.corner + at * grid.quad + half, vec2<f32>(0.0)));
        drop = max(drop, over(before, p, height_before, height, middle_before));
        drop = max(drop, over(p, after, height, height_after, middle_after));
    }
    return drop;
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let grid = grids[instance];
    let row = SIDE + 1u;
    let hanging = vertex >= row * row;
    // of a skirt: side by side, each along its edge
    let side = select(0u, (vertex - row * row) / row + 1u, hanging);
    let along = i32((vertex - row * row) % row);
    let far = select(0, i32(SIDE), side == 2u || side == 4u);
    let on_edge = select(vec2<i32>(along, far), vec2<i32>(far, along), side <= 2u);
    let at = select(vec2<i32>(i32(vertex % row), i32(vertex / row)), on_edge, hanging);
    let p = vertex_place(grid, at);
    let height = height_at(p);
    let lines = vec4<f32>(f32(at.x), f32(at.y), f32(at.x + at.y), 0.5);
    let top = LodVertex(p, height, lines, grid.id, drawn_level(p), grid.tile_level);
    if (side == 0u || ((grid.sides >> (side - 1u)) & 1u) == 0u) { return top; }
    let step = select(vec2<i32>(1, 0), vec2<i32>(0, 1), side <= 2u);
    return hang(top, side, drop_at(grid, at, step, height));
}
