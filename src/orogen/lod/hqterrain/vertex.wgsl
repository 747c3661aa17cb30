#include frame.wgsl
#include lod_vertex.wgsl
// Tiles of nested vertices (Schneider and Westermann 2006): the triangles of their levels of detail in clusters or, in
// the other variant, the ones between tiles.

const SEAMS = #{SEAMS};
const CLUSTER = #{CLUSTER}u;           // triangles drawn together
const FINEST = #{FINEST};              // level of detail that a vertex's level 0 stands for
const NUMBER_BITS = 13u;               // of a vertex number in a seam; above them the tile

struct Tile {
    morphs: vec4<f32>,      // morph factors at the corners: north-west, north-east, south-west, south-east
    corner: vec2<i32>,      // subtexels
    quad: i32,              // subtexels
    page: u32,              // first word in `pages`
    id: u32,
    level: u32,             // of its samples
    tile_level: u32,
    side: f32,              // quads
    detail: i32,            // level of detail of its mesh
}

// Triangles of a tile: word of their first vertex number in `pages`, how many are left from there.
struct Cluster { tile: u32, first_word: u32, left: u32 }

@group(1) @binding(0) var<storage, read> tiles: array<Tile>;
@group(1) @binding(1) var<storage, read> clusters: array<Cluster>;
@group(1) @binding(2) var<storage, read> pages: array<u32>;
@group(1) @binding(3) var<storage, read> seams: array<u32>;

// A tile's vertex at its own morph factor, blended from those of the corners by its place. What the next coarser mesh
// lacks morphs; coarser vertices stay, and those that only meet smaller tiles lie where they would have gone.
fn tile_vertex(tile: Tile, number: u32) -> LodVertex {
    let at = tile.page + 3u * number;
    let packed = pages[at];
    let place = vec2<i32>(vec2<u32>(packed, packed >> 8u) & vec2<u32>(0xffu));
    let way = vec2<f32>(place) / tile.side;
    let along = tile.morphs.xz + (tile.morphs.yw - tile.morphs.xz) * way.x;
    let ahead = tile.detail - (i32(packed >> 16u) + FINEST);
    let morph = clamp(along.x + (along.y - along.x) * way.y + f32(ahead), 0.0, 1.0);
    let own = bitcast<f32>(pages[at + 1u]);
    let height = own + (bitcast<f32>(pages[at + 2u]) - own) * morph;
    let p = clamp_to_extent(Point(tile.corner + place * tile.quad, vec2<f32>(0.0)));
    return LodVertex(p, height, vec4<f32>(0.5), tile.id, tile.level, tile.tile_level);
}

fn seam_vertex(vertex: u32, instance: u32) -> LodVertex {
    let index = instance * 3u * CLUSTER + vertex;
    // what fills a cluster up has no area
    let number = seams[select(arrayLength(&seams) - 1u, index, index < arrayLength(&seams))];
    return tile_vertex(tiles[number >> NUMBER_BITS], number & ((1u << NUMBER_BITS) - 1u));
}

fn cluster_vertex(vertex: u32, instance: u32) -> LodVertex {
    let cluster = clusters[instance];
    let inside = vertex / 3u < cluster.left;
    let corner = select(0u, vertex % 3u, inside);
    let index = 3u * select(0u, vertex / 3u, inside) + corner;
    let word = pages[cluster.first_word + index / 2u];
    var v = tile_vertex(tiles[cluster.tile], (word >> (16u * (index & 1u))) & 0xffffu);
    v.lines = select(vec4<f32>(0.0, 0.0, 0.0, 0.5), vec4<f32>(1.0, 1.0, 1.0, 0.5), vec4<u32>(0u, 1u, 2u, 3u) == vec4<u32>(corner));
    return v;
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    if (SEAMS) { return seam_vertex(vertex, instance); }
    return cluster_vertex(vertex, instance);
}
