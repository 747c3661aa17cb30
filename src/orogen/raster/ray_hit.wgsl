const MISS = -3e38;      // t of a ray that hits nothing: before every start, also those of orthographic cameras

struct RayHit {
    t: f32,              // along the ray, or MISS
    id: u32,
    level: u32,          // of the data
    tile_level: u32,     // of the geometry
    edge: f32,           // pixels to the nearest edge of the geometry
}

fn pack_detail(level: u32, tile_level: u32, edge: f32) -> u32 {
    return min(level, 255u) | (u32(clamp(edge * 16.0, 0.0, 255.0)) << 8u) | (min(tile_level, 255u) << 16u);
}
