#include frame.wgsl
#include lod_vertex.wgsl
#include skirt.wgsl
// Preprocessed chunks (Ulrich 2002): triangles of a page, in clusters, with heights between a chunk's own and its
// parent's, and skirts that hang from its edges.

const NUMBER_BITS = #{NUMBER_BITS}u;   // of a vertex number; above them the side that a skirt hangs on, from 1

struct Chunk {
    drops: vec4<f32>,       // metres of the data that skirts hang down: west, east, north, south
    corner: vec2<i32>,      // subtexels
    unit: i32,              // subtexels from one place of its mesh to the next
    page: u32,              // first word in `pages`
    morph: f32,             // 0: its own heights, 1: the parent's
    id: u32,
    level: u32,             // of its samples
    tile_level: u32,
}

struct Cluster { chunk: u32, first_triangle: u32 }

@group(1) @binding(0) var<storage, read> chunks: array<Chunk>;
@group(1) @binding(1) var<storage, read> clusters: array<Cluster>;
// a page: triangles, word of the first of them; vertices (column, row, height, height of the parent); vertex numbers of
// the triangles, two in a word
@group(1) @binding(2) var<storage, read> pages: array<u32>;

fn vertex_number(page: u32, corner: u32) -> u32 {
    return (pages[page + pages[page + 1u] + corner / 2u] >> (16u * (corner & 1u))) & 0xffffu;
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let cluster = clusters[instance];
    let chunk = chunks[cluster.chunk];
    let last = pages[chunk.page] - 1u;
    let triangle = cluster.first_triangle + vertex / 3u;
    // what fills a cluster up has no area
    let corner = select(vertex % 3u, 0u, triangle > last);
    let number = vertex_number(chunk.page, 3u * min(triangle, last) + corner);
    let at = chunk.page + 2u + 4u * (number & ((1u << NUMBER_BITS) - 1u));
    let p = Point(chunk.corner + vec2<i32>(vec2<u32>(pages[at], pages[at + 1u])) * chunk.unit, vec2<f32>(0.0));
    let own = bitcast<f32>(pages[at + 2u]);
    let height = own + (bitcast<f32>(pages[at + 3u]) - own) * chunk.morph;
    let lines = select(vec4<f32>(0.0, 0.0, 0.0, 0.5), vec4<f32>(1.0, 1.0, 1.0, 0.5), vec4<u32>(0u, 1u, 2u, 3u) == vec4<u32>(corner));
    let top = LodVertex(p, height, lines, chunk.id, chunk.level, chunk.tile_level);
    let side = number >> NUMBER_BITS;
    if (side == 0u) { return top; }
    return hang(top, side, chunk.drops[side - 1u]);
}
