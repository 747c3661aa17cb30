#include polygon.wgsl
// Pieces of large triangles, a block of pixels per workgroup.

const RASTER_SIDE = 8u;           // invocations along a block's side
const RASTER_DRAWERS = #{RASTER_DRAWERS}u;   // workgroups of the dispatch

@compute @workgroup_size(RASTER_SIDE, RASTER_SIDE)
fn draw_blocks(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let blocks = atomicLoad(&raster_queues.blocks);
    if (group.x == 0u && all(local.xy == vec2<u32>(0u))) {
        atomicMax(&raster_queues.most_pieces, atomicLoad(&raster_queues.pieces));
        atomicMax(&raster_queues.most_blocks, blocks);
    }
    let count = min(blocks, arrayLength(&raster_blocks));
    for (var i = group.x; i < count; i += RASTER_DRAWERS) { raster_draw_block(raster_blocks[i], local.xy); }
}

// The pixels of one invocation.
fn raster_draw_block(block: RasterBlock, local: vec2<u32>) {
    let first = vec2<u32>(block.place & 0xffffu, block.place >> 16u) * u32(RASTER_BLOCK) + local;
    let piece = raster_pieces[block.piece];
    let a = piece.positions[0];
    let b = piece.positions[1];
    let c = piece.positions[2];
    let ab = b - a;
    let bc = c - b;
    let ca = a - c;
    let p = vec2<i32>(first) * 256 + 128;
    // edge functions at the first pixel, and what they grow by from one of this invocation's pixels to the next
    let start = array<i64, 3>(raster_cross64(bc, p - b), raster_cross64(ca, p - c), raster_cross64(ab, p - a));
    let least = array<i64, 3>(i64(select(1, 0, raster_owns_edge(bc))), i64(select(1, 0, raster_owns_edge(ca))), i64(select(1, 0, raster_owns_edge(ab))));
    let edges = array<vec2<i32>, 3>(bc, ca, ab);
    for (var n = 0u; n < 16u; n += 1u) {
        let step = vec2<i32>(RASTER_SIDE * vec2<u32>(n & 3u, n >> 2u));
        let pixel = first + vec2<u32>(step);
        let w0 = start[0] + raster_cross64(edges[0], step * 256);
        let w1 = start[1] + raster_cross64(edges[1], step * 256);
        let w2 = start[2] + raster_cross64(edges[2], step * 256);
        if (any(pixel >= frame.size) || w0 < least[0] || w1 < least[1] || w2 < least[2]) { continue; }
        let at = ((vec2<f32>(pixel) + 0.5) / vec2<f32>(frame.size) * 2.0 - 1.0) * vec2<f32>(1.0, -1.0);
        let depth = clamp(dot(piece.depth, vec3<f32>(at, 1.0)), piece.low, piece.high);
        if (!raster_is_ground(pixel, depth)) { continue; }
        raster_show(pixel, depth, piece.triangle);
    }
}
