#include frame.wgsl
#include lod_vertex.wgsl
// Patches of BDAM (Cignoni et al. 2003): triangles of a page, in clusters.

struct Patch {
    corner: vec2<i32>,      // subtexels
    unit: i32,              // subtexels from one place of its vertices to the next
    page: u32,              // first word in `pages`
    id: u32,
    level: u32,             // of samples as far apart as its vertices
    tile_level: u32,        // bisections from the finest patches
}

struct Cluster { patch_number: u32, first_triangle: u32 }

@group(1) @binding(0) var<storage, read> patches: array<Patch>;
@group(1) @binding(1) var<storage, read> clusters: array<Cluster>;
// a page: triangles, word of the first of them; vertices (column, row, height); triangles, ten bits for a vertex number
@group(1) @binding(2) var<storage, read> pages: array<u32>;

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let cluster = clusters[instance];
    let drawn = patches[cluster.patch_number];
    let last = pages[drawn.page] - 1u;
    let triangle = cluster.first_triangle + vertex / 3u;
    // what fills a cluster up has no area
    let corner = select(vertex % 3u, 0u, triangle > last);
    let word = pages[drawn.page + pages[drawn.page + 1u] + min(triangle, last)];
    let at = drawn.page + 2u + 3u * (word >> (10u * corner) & 1023u);
    let p = Point(drawn.corner + vec2<i32>(vec2<u32>(pages[at], pages[at + 1u])) * drawn.unit, vec2<f32>(0.0));
    let lines = select(vec4<f32>(0.0, 0.0, 0.0, 0.5), vec4<f32>(1.0, 1.0, 1.0, 0.5), vec4<u32>(0u, 1u, 2u, 3u) == vec4<u32>(corner));
    return LodVertex(p, bitcast<f32>(pages[at + 2u]), lines, drawn.id, drawn.level, drawn.tile_level);
}
