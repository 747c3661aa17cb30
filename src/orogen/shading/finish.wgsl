#include shade.wgsl
#include develop.wgsl
// One thread a pixel makes the picture from the last sample and the sums of the others.

const FIRST = #{FIRST};         // and only sample

@group(1) @binding(2) var<storage, read_write> accumulated: array<vec4<f32>>;
@group(1) @binding(3) var<uniform> resolve: ResolveBlock;
@group(1) @binding(4) var picture: texture_storage_2d<rgba8unorm, write>;

@compute @workgroup_size(8, 8)
fn finish(@builtin(global_invocation_id) id: vec3<u32>) {
    take_blocks();
    if (any(id.xy >= frame.size)) { return; }
    var light = sample_at(id.xy);
    if (!FIRST) { light += accumulated[id.y * frame.size.x + id.x]; }
    let color = developed(light, resolve);
    textureStore(picture, id.xy, vec4<f32>(srgb_encode(color.rgb), color.a));
}
