#include clipmap.wgsl
#include lod_vertex.wgsl
// One quad over the whole extent: a plane from LEFT to RIGHT metres.

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let corner = vec2<u32>(vertex & 1u, vertex >> 1u);
    let cell = select(frame.extent.xy, frame.extent.zw, corner == vec2<u32>(1u));
    let height = #{LEFT} + f32(corner.x) * (#{RIGHT} - #{LEFT});
    return LodVertex(Point(cell, vec2<f32>(0.0)), height, vec4<f32>(vec2<f32>(corner), f32(corner.x + corner.y), 0.5), #{ID}u + instance, 2u, 7u);
}
