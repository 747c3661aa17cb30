#include clipmap.wgsl
#include lod_vertex.wgsl
// The full-resolution mesh: a vertex in every sample of level 0, in tiles that are all alike but for those next to the
// eye, whose quads are split.

const TILE = #{TILE}u;                   // samples along a tile's side
const SPLIT = #{SPLIT}u;                 // quads along the way from one sample to the next, where they are split
const STEP = #{STEP};                    // subtexels along such a quad
const NODE_COLUMNS = #{NODE_COLUMNS};    // nodes of level 0 in a row
const NEAR_TILES = #{NEAR_TILES}u;       // where in the list the tiles that are split begin
const NEAR = #{NEAR}u;                   // flag in the vertex numbers of those

@group(1) @binding(0) var<storage, read> tiles: array<vec2<u32>>;   // columns and rows
@group(1) @binding(1) var<storage, read> slots: array<u32>;         // of the nodes of level 0, row by row

// Node of level 0, whether or not the quadtree's window reaches that far; the best there is while it is being loaded.
fn finest_node(p: Point) -> Node {
    let cell = p.cell >> vec2<u32>(frame.subtexel_bits + NODE_BITS);
    let slot = slots[cell.y * NODE_COLUMNS + cell.x];
    if (slot == NO_SLOT) { return lookup(HEIGHTS, p.cell, 0u); }
    return Node(slot, 0u, cell, 0u);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let near = (vertex & NEAR) != 0u;
    let number = vertex & ~NEAR;
    let tile = tiles[instance + select(0u, NEAR_TILES, near)];
    let row = TILE * SPLIT + 1u;
    let grid = vec2<u32>(number % row, number / row);
    // what hangs over the data collapses onto its border
    let p = clamp_to_extent(Point(frame.extent.xy + vec2<i32>(tile * TILE * SPLIT + grid) * STEP, vec2<f32>(0.0)));
    let node = finest_node(p);
    let place = vec2<f32>(grid) / f32(select(SPLIT, 1u, near));
    let lines = vec4<f32>(place, place.x + place.y, 0.5);
    return LodVertex(p, node_height(p, node), lines, tile.y << 16u | tile.x, node.level, 0u);
}
