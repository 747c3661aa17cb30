#include frame.wgsl
#include lod_vertex.wgsl
// What an algorithm's `lod_vertex` gives for every corner of the triangles of a draw, written to a list.

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

struct Draw { first: u32, base_vertex: u32, triangles: u32, instances: u32 }

const INDEXED = #{INDEXED};
const STRIP = #{STRIP};

// not a uniform: Mesa 22 crashes where the module has one too
@group(2) @binding(0) var<storage, read> draw: Draw;
@group(2) @binding(1) var<storage, read> indices: array<u32>;
@group(2) @binding(2) var<storage, read_write> written: array<Written>;

@compute @workgroup_size(64)
fn write_corners(@builtin(global_invocation_id) id: vec3<u32>) {
    let number = id.y * 65536u + id.x;
    let count = 3u * draw.triangles;
    if (number >= count * draw.instances || number >= arrayLength(&written)) { return; }
    let instance = number / count;
    let corner = number % count;
    var vertex = draw.first + select(corner, corner / 3u + corner % 3u, STRIP);
    if (INDEXED) { vertex = draw.base_vertex + indices[vertex]; }
    let v = lod_vertex(vertex, instance);
    let position = lift(flat_position(v.point), v.height);
    let offset = vec2<f32>(v.point.cell - frame.anchor) + v.point.frac;
    written[number] = Written(position, v.height, offset, v.lines.xy, v.id, v.level, v.tile_level, instance);
}
