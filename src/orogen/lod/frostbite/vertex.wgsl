#include clipmap.wgsl
#include lod_vertex.wgsl
// The patches of a restricted quadtree (Houska 2019, section 2.3.5): one grid of QUADS x QUADS quads for all of them,
// moved and scaled. A vertex number is a place in the grid and the index list that it stands in.

const QUADS = #{QUADS};
const PATTERNS = #{PATTERNS};

struct Frostbite {
    quad: u32,                                // subtexels along a quad of the finest patches
    starts: array<vec4<u32>, PATTERNS>,       // x: where in the list of patches those of an index list begin
}

struct Patch { place: vec2<i32>, level: u32, unused: u32 }

@group(1) @binding(0) var<uniform> frostbite: Frostbite;
@group(1) @binding(1) var<storage, read> patches: array<Patch>;

// Triangle edges: columns, rows, and the diagonals through the middles of all blocks of two by two quads. A line that
// ends in a removed vertex is not there.
fn lines_at(grid: vec2<i32>, hidden: vec2<bool>) -> vec4<f32> {
    let at = vec2<f32>(grid);
    return vec4<f32>(select(at, vec2<f32>(0.5), hidden), 0.5 * (at.x + at.y), 0.5 * (at.x - at.y));
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let pattern = vertex >> #{PATTERN}u;
    let hidden = ((vec2<u32>(vertex) >> vec2<u32>(#{HIDE_COLUMN}u, #{HIDE_ROW}u)) & vec2<u32>(1u)) == vec2<u32>(1u);
    let grid = vec2<i32>(vec2<u32>(vertex, vertex >> #{ROW}u) & vec2<u32>(63u));
    let piece = patches[frostbite.starts[pattern].x + instance];
    let quad = i32(frostbite.quad << piece.level);
    // what hangs over the data collapses onto its border: all triangles have a side along a row or column, so none
    // turns over
    let p = clamp_to_extent(Point(frame.extent.xy + (piece.place * QUADS + grid) * quad, vec2<f32>(0.0)));
    let id = (piece.level << 26u) ^ (u32(piece.place.y) << 13u) ^ u32(piece.place.x);
    return LodVertex(p, height_at(p), lines_at(grid, hidden), id, drawn_level(p), piece.level);
}
