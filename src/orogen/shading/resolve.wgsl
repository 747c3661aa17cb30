// Accumulated light to a picture: mean, exposure, tone curve, background, sRGB.

struct ResolveBlock {
    background: vec4<f32>,      // linear RGB; alpha 0: leave what nothing covers transparent
    share: f32,                 // 1 / samples
    exposure: f32,
    width: u32,                 // pixels
    flags: u32,
}

const TONED = 1u;               // exposure and tone curve apply
const ENCODED = 2u;             // the target stores what it is given: encode for sRGB here

@group(0) @binding(0) var<uniform> resolve: ResolveBlock;
@group(0) @binding(1) var<storage, read> accumulated: array<vec4<f32>>;

const SHOULDER = 0.75;          // brightness from which the curve bends towards 1

// Compresses highlights by the brightest channel alone, which keeps the hue; the rest stays as it is.
fn tone(color: vec3<f32>) -> vec3<f32> {
    let peak = max(color.r, max(color.g, color.b));
    if (peak <= SHOULDER) { return color; }
    let room = 1.0 - SHOULDER;
    return color * ((1.0 - room * exp((SHOULDER - peak) / room)) / peak);
}

fn srgb_encode(linear: vec3<f32>) -> vec3<f32> {
    let x = clamp(linear, vec3<f32>(0.0), vec3<f32>(1.0));
    return select(1.055 * pow(x, vec3<f32>(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3<f32>(0.0031308));
}

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // one triangle over the whole picture
    return vec4<f32>(vec2<f32>(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn develop(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = vec2<u32>(position.xy);
    let sum = accumulated[pixel.y * resolve.width + pixel.x] * resolve.share;
    var color = sum.rgb / max(sum.a, 1e-6);
    if ((resolve.flags & TONED) != 0u) { color = tone(color * resolve.exposure); }
    let alpha = mix(sum.a, 1.0, resolve.background.a);
    // colours are not multiplied by alpha, as picture files want them
    color = mix(color, resolve.background.rgb, (1.0 - sum.a) * resolve.background.a);
    if ((resolve.flags & ENCODED) != 0u) { color = srgb_encode(color); }
    return vec4<f32>(color, alpha);
}
