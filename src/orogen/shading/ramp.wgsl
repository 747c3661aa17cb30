// The colour ramp (ramp.py): linear RGB, evenly spaced.
const RAMP_LAST = 255u;

@group(1) @binding(1) var<uniform> ramp: array<vec4<f32>, 256>;

// Colour at 0 (lowest) to 1 (highest), clamped.
fn ramp_color(position: f32) -> vec3<f32> {
    let x = clamp(position, 0.0, 1.0) * f32(RAMP_LAST);
    let low = min(u32(x), RAMP_LAST - 1u);
    return mix(ramp[low].rgb, ramp[low + 1u].rgb, x - f32(low));
}
