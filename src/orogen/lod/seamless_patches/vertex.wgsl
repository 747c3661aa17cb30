#include clipmap.wgsl
#include lod_vertex.wgsl
// Triles and stitching strips of patches (Houska 2019, section 2.3.4): cached meshes, turned, scaled, moved. A vertex
// number is a place in a mesh and the mesh itself (meshes.py).

const MOST = #{MOST};                  // units along a patch's side
const MESHES = #{MESHES};
const TRILES = #{TRILES}u;             // the first meshes, one per resolution 2, 4 ...; strips follow

struct Block {
    unit: u32,                         // subtexels along a unit of the finest patches
    starts: array<vec4<u32>, MESHES>,  // x: where in the list of pieces those of a mesh begin
}

struct Piece {
    place: vec2<i32>,                  // column and row of the patch
    level: u32,
    turn: u32,                         // quarters, clockwise
}

@group(1) @binding(0) var<uniform> block: Block;
@group(1) @binding(1) var<storage, read> pieces: array<Piece>;

fn turned(at: vec2<i32>, turn: u32) -> vec2<i32> {
    switch turn {
        case 1u: { return vec2<i32>(MOST - at.y, at.x); }
        case 2u: { return MOST - at; }
        case 3u: { return vec2<i32>(at.y, MOST - at.x); }
        default: { return at; }
    }
}

// Triangle edges. A trile has columns, rows, and diagonals through every other vertex; in a strip's triangle one of the
// three falls to 0 along each side.
fn lines_at(at: vec2<i32>, mesh: u32, corner: u32) -> vec4<f32> {
    if (mesh >= TRILES) { return vec4<f32>(vec3<f32>(vec3<u32>(corner) == vec3<u32>(1u, 2u, 3u)), 0.5); }
    let grid = vec2<f32>(at) * f32(2u << mesh) / f32(MOST);
    return vec4<f32>(grid, 0.5 * (grid.x + grid.y + 1.0), 0.5 * (grid.x - grid.y + 1.0));
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let mesh = vertex >> #{MESH}u;
    let corner = (vertex >> #{CORNER}u) & 3u;
    let at = vec2<i32>(vec2<u32>(vertex, vertex >> #{ROW}u) & vec2<u32>(127u));
    let piece = pieces[block.starts[mesh].x + instance];
    let unit = i32(block.unit << piece.level);
    // what hangs over the data collapses onto its border
    let cell = frame.extent.xy + (piece.place * MOST + turned(at, piece.turn)) * unit;
    let p = clamp_to_extent(Point(cell, vec2<f32>(0.0)));
    let id = (piece.level << 26u) ^ (u32(piece.place.y) << 13u) ^ u32(piece.place.x);
    return LodVertex(p, height_at(p), lines_at(at, mesh, corner), id, drawn_level(p), piece.level);
}
