#include frame.wgsl
// Rays only where the algorithm's `lod_replaces` wants others than what was drawn.

fn should_cast(pixel: vec2<u32>) -> bool {
    let depth = textureLoad(surface_depths, pixel).x;
    return lod_replaces(pixel, depth, textureLoad(surface_ids, pixel).x, textureLoad(surface_details, pixel).x);
}
