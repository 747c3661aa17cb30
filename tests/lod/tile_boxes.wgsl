#include lod/tile_vertex.wgsl
#include lod/tile_box.wgsl
// The boxes around the tiles of a draw, and whether they count as empty.

struct Measured { low: vec3<f32>, empty: u32, high: vec3<f32>, outside: u32 }

@group(2) @binding(0) var<storage, read> drawn: array<u32>;   // arguments of the indirect draw
@group(2) @binding(1) var<storage, read_write> measured: array<Measured>;

@compute @workgroup_size(64)
fn measure_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= drawn[1]) { return; }
    let tile = tiles[id.x];
    let low = tile_corner(Tile(tile.x, tile.y, tile.level));
    let high = min(low + quad_size(tile.level) * i32(tiling.grid_size), frame.extent.zw);
    let reach = reach_of(low, high);
    let box = box_between(low, high, bounds_below(low, high, reach, bounds_around(low, high)));
    let empty = is_empty(low, high, reach, box);
    measured[id.x] = Measured(box.low, select(0u, 1u, empty), box.high, select(0u, 1u, box_outside(box)));
}
