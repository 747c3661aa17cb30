#include develop.wgsl
// The samples so far as a picture in a texture that can only be drawn to: a window's.

@group(0) @binding(0) var<uniform> resolve: ResolveBlock;
@group(0) @binding(1) var<storage, read> accumulated: array<vec4<f32>>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // one triangle over the whole picture
    return vec4<f32>(vec2<f32>(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn develop(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(position.xy);
    return developed(accumulated[pixel.y * resolve.width + pixel.x], resolve);
}
