// Summed light to the colour of a picture: mean, exposure, tone curve, background; and to sRGB.

struct ResolveBlock {
    background: vec4<f32>,      // linear RGB; alpha 0: leave what nothing covers transparent
    share: f32,                 // 1 / samples
    exposure: f32,
    width: u32,                 // pixels
    flags: u32,
}

const TONES = #{TONES};         // they may: what never does is left out
const TONED = 1u;               // exposure and tone curve apply

const SHOULDER = 0.75;          // brightness from which the curve bends towards 1

// Compresses highlights by the brightest channel alone, which keeps the hue; the rest stays as it is.
fn tone(color: vec3<f32>) -> vec3<f32> {
    let peak = max(color.r, max(color.g, color.b));
    let room = 1.0 - SHOULDER;
    let bent = (1.0 - room * exp((SHOULDER - peak) / room)) / max(peak, SHOULDER);
    return color * select(bent, 1.0, peak <= SHOULDER);
}

fn srgb_encode(linear: vec3<f32>) -> vec3<f32> {
    let x = clamp(linear, vec3<f32>(0.0), vec3<f32>(1.0));
    return select(1.055 * pow(x, vec3<f32>(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3<f32>(0.0031308));
}

// Linear RGB and alpha; colours are not multiplied by alpha, as picture files want them.
fn developed(light: vec4<f32>, resolve: ResolveBlock) -> vec4<f32> {
    let sum = light * resolve.share;
    var color = sum.rgb / max(sum.a, 1e-6);
    // chosen, not branched: Mesa's software driver keeps a third of a megabyte at every draw with such branches
    if (TONES) { color = select(color, tone(color * resolve.exposure), (resolve.flags & TONED) != 0u); }
    let alpha = mix(sum.a, 1.0, resolve.background.a);
    color = mix(color, resolve.background.rgb, (1.0 - sum.a) * resolve.background.a);
    return vec4<f32>(color, alpha);
}
