#include farcry5.wgsl
#include patch_word.wgsl
// Where the vertices of a patch lie. On a side with coarser ground beyond, those that the neighbour does not have move to
// the one before that it has (edge stitching), in integers: shared vertices are the same to the bit.

fn snapped(at: u32, steps: u32) -> u32 { return (at >> steps) << steps; }

fn vertex_point(tile: PatchTile, place: vec2<u32>) -> Point {
    let level = level_of(tile);
    let steps = steps_of(tile);
    let at = vec2<u32>(tile.x, tile.y) * QUADS + place;
    var moved = at;
    if (place.x == 0u) { moved.y = snapped(at.y, steps.x); }
    if (place.x == QUADS) { moved.y = snapped(at.y, steps.y); }
    if (place.y == 0u) { moved.x = snapped(at.x, steps.z); }
    if (place.y == QUADS) { moved.x = snapped(at.x, steps.w); }
    // the neighbour's next vertex past the end of the data lies on that end, too
    let past = frame.extent.xy + vec2<i32>(at) * quad_size(level) >= frame.extent.zw;
    let cell = frame.extent.xy + vec2<i32>(select(moved, at, past)) * quad_size(level);
    return clamp_to_extent(Point(cell, vec2<f32>(0.0)));
}
