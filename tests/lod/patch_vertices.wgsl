#include frame.wgsl
#include lod_vertex.wgsl
// What an algorithm's `lod_vertex` gives for the EACH vertices of every patch of a draw, written to a list.

struct Written {
    position: vec3<f32>,   // camera-relative metres
    height: f32,
    offset: vec2<f32>,     // subtexels from the anchor
    grid: vec2<f32>,
    id: u32,
    level: u32,
    tile_level: u32,
    instance: u32,
}

@group(2) @binding(0) var<storage, read> drawn: array<u32>;   // arguments of the indirect draw
@group(2) @binding(1) var<storage, read_write> written: array<Written>;

@compute @workgroup_size(64)
fn write_vertices(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = id.y * 65536u + id.x;
    if (index >= #{EACH}u * drawn[1] || index >= arrayLength(&written)) { return; }
    let instance = index / #{EACH}u;
    let v = lod_vertex(index % #{EACH}u, instance);
    let position = lift(flat_position(v.point), v.height);
    let offset = vec2<f32>(v.point.cell - frame.anchor) + v.point.frac;
    written[index] = Written(position, v.height, offset, v.lines.xy, v.id, v.level, v.tile_level, instance);
}
