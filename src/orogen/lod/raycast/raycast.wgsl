#include trace.wgsl
#include ray_hit.wgsl

fn lod_ray(ray: Ray, from_t: f32, to_t: f32) -> RayHit {
    let hit = trace(ray, from_t, to_t, true);
    if (!hit.found) { return RayHit(MISS, 0u, 0u, 0u, 0.0); }
    // the nearest border of the cell, in pixels of a texel seen face on
    let border = min(min(hit.way.x, 1.0 - hit.way.x), min(hit.way.y, 1.0 - hit.way.y));
    let texel = frame.spacing * f32(1u << hit.level);
    let id = (hit.level << 26u) ^ (vec2<u32>(hit.node).y << 13u) ^ vec2<u32>(hit.node).x;
    return RayHit(hit.t, id, hit.level, hit.level, border * texel * pixels_per_metre(hit.t));
}
