#include clipmap.wgsl
#include lod_vertex.wgsl
// One level quad that reaches BY subtexels past the extent on every side.

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let corner = vec2<u32>(vertex & 1u, vertex >> 1u);
    let cell = select(frame.extent.xy - #{BY}, frame.extent.zw + #{BY}, corner == vec2<u32>(1u));
    let lines = vec4<f32>(vec2<f32>(corner), f32(corner.x + corner.y), 0.5);
    return LodVertex(Point(cell, vec2<f32>(0.0)), #{HEIGHT}, lines, #{ID}u + instance, 2u, 7u);
}
