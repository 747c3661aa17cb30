#include polygon.wgsl
// Clips large triangles, cuts them into pieces, and lists the blocks of pixels that each piece reaches.

const RASTER_SPLITTERS = #{RASTER_SPLITTERS}u;   // invocations of the dispatch

@compute @workgroup_size(64)
fn split_large(@builtin(global_invocation_id) id: vec3<u32>) {
    let large = atomicLoad(&raster_queues.large);
    if (id.x == 0u) { atomicMax(&raster_queues.most_large, large); }
    let count = min(large, arrayLength(&raster_large));
    for (var i = id.x; i < count; i += RASTER_SPLITTERS) { raster_split(raster_large[i]); }
}

fn raster_split(triangle: u32) {
    let polygon = raster_clipped(triangle);
    // as for small ones: see RasterDepthPlane
    var low = 1.0;
    var high = 0.0;
    for (var i = 0u; i < polygon.count; i += 1u) {
        let depth = polygon.clip[i].z / polygon.clip[i].w;
        low = min(low, depth);
        high = max(high, depth);
    }
    for (var i = 2u; i < polygon.count; i += 1u) {
        var piece: RasterPiece;
        piece.depth = polygon.depth;
        piece.triangle = triangle;
        piece.low = max(2.0 * low - high, 1e-30);
        piece.high = min(2.0 * high - low, 1.0);
        for (var k = 0u; k < 3u; k += 1u) {
            piece.positions[k] = raster_fixed_position(polygon.clip[select(i - 2u + k, 0u, k == 0u)]);
        }
        raster_add_piece(piece);
    }
}

fn raster_add_piece(given: RasterPiece) {
    var piece = given;
    let a = piece.positions[0];
    let area = raster_cross64(piece.positions[1] - a, piece.positions[2] - a);
    if (area == i64(0)) { return; }
    if (area < i64(0)) {
        // clockwise on screen, whichever side is seen
        piece.positions[1] = given.positions[2];
        piece.positions[2] = given.positions[1];
    }
    let low = min(min(a, piece.positions[1]), piece.positions[2]);
    let high = max(max(a, piece.positions[1]), piece.positions[2]);
    let first = max((low + 127) >> vec2<u32>(8u), vec2<i32>(0)) / RASTER_BLOCK;
    let last = min((high - 128) >> vec2<u32>(8u), vec2<i32>(frame.size) - 1);
    if (any(last < vec2<i32>(0))) { return; }
    let stop = last / RASTER_BLOCK;
    let at = atomicAdd(&raster_queues.pieces, 1u);
    if (at >= arrayLength(&raster_pieces)) { return; }
    raster_pieces[at] = piece;
    for (var y = first.y; y <= stop.y; y += 1) {
        for (var x = first.x; x <= stop.x; x += 1) {
            if (!raster_reaches(piece, vec2<i32>(x, y))) { continue; }
            let block = atomicAdd(&raster_queues.blocks, 1u);
            if (block < arrayLength(&raster_blocks)) { raster_blocks[block] = RasterBlock(at, u32(x) | (u32(y) << 16u)); }
        }
    }
}

// False where the block lies wholly outside one of the edges.
fn raster_reaches(piece: RasterPiece, block: vec2<i32>) -> bool {
    let low = block * (RASTER_BLOCK * 256);
    let high = low + RASTER_BLOCK * 256;
    for (var i = 0u; i < 3u; i += 1u) {
        let a = piece.positions[i];
        let edge = piece.positions[select(i + 1u, 0u, i == 2u)] - a;
        // the corner of the block that lies farthest inside
        let corner = vec2<i32>(select(high.x, low.x, edge.y > 0), select(low.y, high.y, edge.x > 0));
        if (raster_cross64(edge, corner - a) < i64(0)) { return false; }
    }
    return true;
}
