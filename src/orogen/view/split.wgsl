// Two pictures in one: side by side, one over the other up to a divider, or the second's height over the first.

struct Ray {
    right: vec4<f32>,           // across half the picture at view depth 1 (perspective) or in metres (orthographic)
    up: vec4<f32>,
    forward: vec4<f32>,
    jitter: vec4<f32>,          // of the first and of the second picture's latest sample, in pixels
}

struct SplitBlock {
    ray: Ray,
    size: vec2<f32>,            // of the whole, in pixels
    divider: f32,               // column of the first pixel right of it
    mode: u32,
    limit: f32,                 // metres that the strongest colour stands for
    near: f32,                  // metres: a perspective camera's depth is this over the view depth
    encode: u32,                // the target stores what it is given: encode for sRGB here
    exaggeration: f32,
    depth_scale: vec4<f32>,     // an orthographic camera's view depth is x + y * depth, z + w * depth in the second; else 0
    line: f32,                  // half the divider's width in pixels; 0: none
}

const WHOLE = 0u;
const WIPE = 1u;
const BESIDE = 2u;
const DIFFERENCE = 3u;

@group(0) @binding(0) var<uniform> split: SplitBlock;
@group(0) @binding(1) var linear: sampler;
@group(0) @binding(2) var first: texture_2d<f32>;
@group(0) @binding(3) var second: texture_2d<f32>;
@group(0) @binding(4) var first_depth: texture_2d<f32>;
@group(0) @binding(5) var second_depth: texture_2d<f32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(vec2<f32>(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// Metres from the camera of what a pixel shows; w: 0 for the sky.
fn point_at(depths: texture_2d<f32>, pixel: vec2<i32>, jitter: vec2<f32>, scale: vec2<f32>) -> vec4<f32> {
    let size = vec2<i32>(textureDimensions(depths));
    let at = clamp(pixel, vec2<i32>(0), size - 1);
    let depth = textureLoad(depths, at, 0).r;
    let place = (vec2<f32>(at) + 0.5 + jitter) / vec2<f32>(size) * 2.0 - 1.0;
    let across = place.x * split.ray.right.xyz - place.y * split.ray.up.xyz;
    if (scale.y != 0.0) {
        return vec4<f32>(across + (scale.x + scale.y * depth) * split.ray.forward.xyz, depth);
    }
    return vec4<f32>((across + split.ray.forward.xyz) * (split.near / max(depth, 1e-30)), depth);
}

// The shorter of the two differences to the neighbours: the other one may leap over a silhouette. At the picture's edge
// there is one neighbour; the difference to the other is nothing.
fn shorter(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    let one = dot(a, a);
    let other = dot(b, b);
    return select(b, a, one > 0.0 && (one < other || other == 0.0));
}

// Height of the second surface over the first (m): the distance of its point from the first's tangent plane, upwards.
fn height_over(pixel: vec2<i32>) -> vec2<f32> {
    let j = split.ray.jitter.xy;
    let scale = split.depth_scale.xy;
    let a = point_at(first_depth, pixel, j, scale);
    let b = point_at(second_depth, pixel, split.ray.jitter.zw, split.depth_scale.zw);
    if (a.w == 0.0 || b.w == 0.0) { return vec2<f32>(0.0); }
    let x = shorter(
        point_at(first_depth, pixel + vec2<i32>(1, 0), j, scale).xyz - a.xyz,
        a.xyz - point_at(first_depth, pixel - vec2<i32>(1, 0), j, scale).xyz,
    );
    let y = shorter(
        point_at(first_depth, pixel - vec2<i32>(0, 1), j, scale).xyz - a.xyz,
        a.xyz - point_at(first_depth, pixel + vec2<i32>(0, 1), j, scale).xyz,
    );
    let normal = cross(x, y);
    if (normal.z <= 0.05 * length(normal)) { return vec2<f32>(0.0); }    // seen edge on: no answer
    return vec2<f32>(dot(b.xyz - a.xyz, normal) / normal.z / split.exaggeration, 1.0);
}

// Blue: the second is lower; white: alike; red: it is higher.
fn diverging(x: f32) -> vec3<f32> {
    let t = clamp(x, -1.0, 1.0);
    let cold = vec3<f32>(0.02, 0.19, 0.59);
    let warm = vec3<f32>(0.62, 0.05, 0.04);
    return mix(vec3<f32>(0.9), select(warm, cold, t < 0.0), abs(t));
}

fn srgb(linear_color: vec3<f32>) -> vec3<f32> {
    let x = clamp(linear_color, vec3<f32>(0.0), vec3<f32>(1.0));
    return select(1.055 * pow(x, vec3<f32>(1.0 / 2.4)) - 0.055, 12.92 * x, x <= vec3<f32>(0.0031308));
}

@fragment
fn join(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let at = position.xy;
    // both are sampled whatever the mode: neighbouring pixels may differ in it
    let whole = at / split.size;
    let left = vec2<f32>(at.x / max(split.divider, 1.0), whole.y);
    let right = vec2<f32>((at.x - split.divider) / max(split.size.x - split.divider, 1.0), whole.y);
    let beside = split.mode == BESIDE;
    let a = textureSampleLevel(first, linear, select(whole, left, beside), 0.0);
    let b = textureSampleLevel(second, linear, select(whole, right, beside), 0.0);
    if (split.mode == WHOLE) { return a; }
    if (abs(at.x - split.divider) < split.line) { return vec4<f32>(1.0); }
    if (split.mode == DIFFERENCE && at.x >= split.divider) {
        let scale = vec2<f32>(textureDimensions(first_depth)) / split.size;
        let found = height_over(vec2<i32>(at * scale));
        if (found.y == 0.0) { return a; }
        let color = diverging(found.x / split.limit);
        return vec4<f32>(select(color, srgb(color), split.encode != 0u), 1.0);
    }
    return select(a, b, at.x >= split.divider);
}
