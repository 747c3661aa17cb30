#include place.wgsl
#include lod_vertex.wgsl

@group(1) @binding(1) var<storage, read> patches: array<PatchTile>;
@group(1) @binding(2) var<storage, read> numbers: array<u32>;   // of the patches to draw

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let tile = patches[numbers[instance]];
    let place = vec2<u32>(vertex % (QUADS + 1u), vertex / (QUADS + 1u));
    let p = vertex_point(tile, place);
    let id = (level_of(tile) << 26u) ^ (tile.y << 13u) ^ tile.x;
    let lines = vec4<f32>(vec2<f32>(place), f32(place.x + place.y), 0.5);
    return LodVertex(p, height_at(p), lines, id, drawn_level(p), level_of(tile));
}
