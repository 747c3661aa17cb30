// Per pixel reverse-z depth in the upper half and the triangle in the lower: the greatest is what is seen.
@group(2) @binding(2) var<storage, read_write> raster_visibility: array<atomic<u64>>;

fn raster_show(pixel: vec2<u32>, depth: f32, triangle: u32) {
    let value = (u64(bitcast<u32>(depth)) << 32u) | u64(triangle);
    atomicMax(&raster_visibility[pixel.y * frame.size.x + pixel.x], value);
}

// Numbers of triangles that are drawn block by block, the pieces they are cut into and the blocks of those; what finds no
// room is counted all the same. Then the most that were in this picture, and the number of the next batch's first workgroup.
struct RasterQueues {
    large: atomic<u32>, pieces: atomic<u32>, blocks: atomic<u32>,
    most_large: atomic<u32>, most_pieces: atomic<u32>, most_blocks: atomic<u32>, next: u32,
}
@group(2) @binding(3) var<storage, read_write> raster_queues: RasterQueues;
@group(2) @binding(4) var<storage, read_write> raster_large: array<u32>;
