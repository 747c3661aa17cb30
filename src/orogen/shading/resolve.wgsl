#include develop.wgsl
// The samples so far as a picture in a texture that can only be drawn to: a window's.

const STEP = #{STEP};           // of the target's colours, in sRGB; 0: finer than anyone sees
const ENCODES = #{ENCODES};     // the target itself encodes what it is given for sRGB

@group(0) @binding(0) var<uniform> resolve: ResolveBlock;
@group(0) @binding(1) var<storage, read> accumulated: array<vec4<f32>>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // one triangle over the whole picture
    return vec4<f32>(vec2<f32>(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// From -0.5 to 0.5, spread evenly over every few pixels (Roberts 2018, R2); whole numbers, so the same on all drivers.
fn threshold(pixel: vec2<u32>) -> f32 {
    return f32((pixel.x * 3242174889u + pixel.y * 2447445414u) >> 8u) / 16777216.0 - 0.5;
}

fn srgb_decode(encoded: vec3<f32>) -> vec3<f32> {
    let x = max(encoded, vec3<f32>(0.0));
    return select(pow((x + 0.055) / 1.055, vec3<f32>(2.4)), x / 12.92, x <= vec3<f32>(0.04045));
}

@fragment
fn develop(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(position.xy);
    let color = developed(accumulated[pixel.y * resolve.width + pixel.x], resolve);
    // rounded up or down in turn where it lies between two steps, so that no bands show; what is on a step stays
    var encoded = srgb_encode(color.rgb) + 0.98 * STEP * threshold(pixel);
    if (ENCODES) { encoded = srgb_decode(encoded); }
    return vec4<f32>(encoded, color.a);
}
