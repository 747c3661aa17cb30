#include trace.wgsl
#include ray_hit.wgsl
#include blocks.wgsl
// Rays through the pixels where a ray tile may lie before what was drawn. What they find is the true surface, in whose
// tile ever: so no gap is left between triangles and rays.

@group(1) @binding(0) var<storage, read_write> blocks: array<Block>;

fn lod_replaces(pixel: vec2<u32>, depth: f32, id: u32, detail: u32) -> bool {
    let block = block_index(pixel >> vec2<u32>(BLOCK_BITS));
    let entry = atomicLoad(&blocks[block].entry);
    if (entry == 0u || entry < bitcast<u32>(depth)) { return false; }
    atomicAdd(&blocks[block].rays, 1u);
    return true;
}

fn lod_ray(ray: Ray, from_t: f32, to_t: f32) -> RayHit {
    let hit = trace(ray, from_t, to_t, true);
    if (!hit.found) { return RayHit(MISS, 0u, 0u, 0u, 0.0); }
    let id = (hit.level << 26u) ^ (vec2<u32>(hit.node).y << 13u) ^ vec2<u32>(hit.node).x;
    // no edges: the wireframe shows which pixels are triangles
    return RayHit(hit.t, id, hit.level, hit.level, 1e3);
}
