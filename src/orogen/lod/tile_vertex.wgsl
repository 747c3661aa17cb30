#include lod/tiles.wgsl
#include lod_vertex.wgsl
// Tiles that are drawn as triangles: vertices that morph into those of the next level (Kuehnert 2022, section 5.1).

const COLUMNS = #{COLUMNS}u;    // vertices along a tile's side: a constant, since divisions by others are slow

@group(1) @binding(1) var<storage, read> tiles: array<FinalTile>;

// 0 where the level's own grid stands, 1 where it has become that of the next level (figure 5.5).
fn morph_ratio(p: Point, level: u32) -> f32 {
    if (level == tiling.root_level) { return 0.0; }
    let way = lod_distance(flat_position(p)) / range_end(level);
    return clamp(1.0 - (1.0 - way) / tiling.morph_range, 0.0, 1.0);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let tile = tiles[instance];
    let grid = vec2<u32>(vertex % COLUMNS, vertex / COLUMNS);
    let quad = quad_size(tile.level);
    let whole = Point(tile_corner(Tile(tile.x, tile.y, tile.level)) + vec2<i32>(grid) * quad, vec2<f32>(0.0));
    let morph = morph_ratio(clamp_to_extent(whole), tile.level);
    // equation 4.6 with `grid & 1`, as in figure 5.5: odd vertices move to the even one before them
    let odd = vec2<i32>(grid & vec2<u32>(1u));
    var p = whole;
    if (morph >= 1.0) {
        // in integers: these vertices coincide with the neighbour's to the bit
        p.cell -= odd * quad;
    } else if (morph > 0.0) {
        let shift = morph * f32(quad) * vec2<f32>(odd);
        let steps = ceil(shift);
        p = Point(whole.cell - vec2<i32>(steps), steps - shift);
    }
    p = clamp_to_extent(p);
    let id = (tile.level << 26u) ^ (tile.y << 13u) ^ tile.x;
    let lines = vec4<f32>(vec2<f32>(grid), f32(grid.x + grid.y), 0.5);
    return LodVertex(p, tile_height(p, tile.node), lines, id, drawn_level(p), tile.level);
}
