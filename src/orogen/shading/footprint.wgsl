#include frame.wgsl
// What a pixel covers on the ground, from its own ray and the tangent plane: differences of neighbouring pixels would
// smear silhouettes.

const LEAST_FACING = 0.01;      // sine of the grazing angle below which a footprint grows no further

// How the point at view depth t moves with a step of one pixel to the right and one down, at constant t.
fn pixel_steps(t: f32) -> mat2x3<f32> {
    let scale = 2.0 * select(t, 1.0, frame.forward.w > 0.5) / vec2<f32>(frame.size);
    return mat2x3<f32>(scale.x * frame.right.xyz, -scale.y * frame.up.xyz);
}

// The same steps along the tangent plane: with the hit o + t d, its step is s + dt d, and n . (s + dt d) = 0 gives dt.
fn tangent_steps(steps: mat2x3<f32>, direction: vec3<f32>, normal: vec3<f32>) -> mat2x3<f32> {
    let facing = min(dot(normal, direction), -LEAST_FACING * length(direction));
    return mat2x3<f32>(
        steps[0] - direction * (dot(normal, steps[0]) / facing),
        steps[1] - direction * (dot(normal, steps[1]) / facing));
}

// The steps in subtexels.
fn footprint_of(steps: mat2x3<f32>) -> mat2x2<f32> {
    return mat2x2<f32>(to_subtexels(steps[0].xy), to_subtexels(steps[1].xy));
}

// Pixels on the screen that a step of one metre upwards covers at a point with these pixel steps.
fn pixels_per_rise(steps: mat2x3<f32>, direction: vec3<f32>) -> f32 {
    let axis = cross(steps[0], steps[1]);
    // along the ray back to the picture's plane, then measured in its pixels
    let shift = vec3<f32>(0.0, 0.0, 1.0) - direction * (axis.z / dot(axis, direction));
    return length(vec2<f32>(dot(shift, steps[0]) / dot(steps[0], steps[0]), dot(shift, steps[1]) / dot(steps[1], steps[1])));
}
