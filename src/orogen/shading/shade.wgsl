#include frame.wgsl
#include surface.wgsl
#include clipmap.wgsl
#include trace.wgsl
#include sky.wgsl
#include ramp.wgsl
#include footprint.wgsl
#include overlay.wgsl
// Surface buffer to light. Ignorant of how the surface was drawn.

const LIT = 1u;
const SHADOWS = 2u;
const SKY = 4u;                 // the background is the sky, not left transparent
const WIREFRAME = 8u;
const LEVELS = 16u;
const NODES = 32u;
const CONTOURS = 64u;
const ERROR = 128u;
const IMAGE = 256u;
const RAMP = 512u;
// Fixed when the pipeline is made: software drivers run both sides of every branch.
const FLAGS = #{FLAGS}u;

const PLAIN = vec3<f32>(0.36);
const WIRE_COLOR = vec4<f32>(0.0, 0.0, 0.0, 0.65);
const CONTOUR_COLOR = vec4<f32>(0.045, 0.022, 0.008, 0.75);
const NODE_COLOR = vec4<f32>(0.9, 0.9, 0.9, 0.8);

struct StyleBlock {
    light: Light,
    ramp_low: f32,              // metres of the data at the ramp's lower end
    ramp_scale: f32,            // 1 / m
    contour_interval: f32,      // metres of the data
    error_limit: f32,           // pixels
    wireframe_width: f32,       // pixels
    padding: vec2<f32>,
}

@group(1) @binding(0) var<uniform> style: StyleBlock;

// What the shading of one pixel needs to know of the surface.
struct Ground {
    position: vec3<f32>,        // camera-relative metres
    point: Point,
    normal: vec3<f32>,
    height: f32,                // metres of the data
    steps: mat2x3<f32>,         // per pixel, on the tangent plane, metres
    footprint: mat2x2<f32>,     // the same in subtexels
}

fn has(flag: u32) -> bool { return (FLAGS & flag) != 0u; }

fn over(below: vec3<f32>, color: vec4<f32>, cover: f32) -> vec3<f32> {
    return mix(below, color.rgb, color.a * cover);
}

fn ground_at(ray: Ray, t: f32) -> Ground {
    let position = ray.origin + t * ray.direction;
    let point = ground_point(position);
    let steps = pixel_steps(t);
    // the shorter axis of the footprint on level ground: its own axis would need the normal twice, for half a level at 45
    // degrees
    let level = max(lod_at(point), log2(length(steps[0]) / frame.spacing));
    let normal = normalize(vec3<f32>(-gradient_at(point, level), 1.0));
    let tangent = tangent_steps(steps, ray.direction, normal);
    return Ground(position, point, normal, world_height(position), tangent, footprint_of(tangent));
}

fn base_color(ground: Ground) -> vec3<f32> {
    var color = PLAIN;
    if (has(RAMP)) { color = ramp_color((ground.height - style.ramp_low) * style.ramp_scale); }
    if (has(IMAGE)) {
        let image = color_at(ground.point, ground.footprint);
        color = mix(color, image.rgb, image.a);
    }
    return color;
}

fn error_pixels(ground: Ground, ray: Ray, t: f32) -> f32 {
    return error_at(ground.point) * frame.exaggeration * pixels_per_rise(pixel_steps(t), ray.direction);
}

// Column and row of the clipmap's node, and its level.
fn node_at(point: Point) -> vec3<i32> {
    let level = resident_level(point, u32(lod_at(point)));
    return vec3<i32>(point.cell >> vec2<u32>(frame.subtexel_bits + NODE_BITS + level), i32(level));
}

fn node_border_cover(ground: Ground, level: i32) -> f32 {
    let side = 1i << (frame.subtexel_bits + NODE_BITS + u32(level));
    let inside = vec2<f32>(ground.point.cell & vec2<i32>(side - 1)) + ground.point.frac;
    let f = ground.footprint;
    let slopes = vec2<f32>(length(vec2<f32>(f[0].x, f[1].x)), length(vec2<f32>(f[0].y, f[1].y)));
    let columns = isoline_cover(inside.x, f32(side), slopes.x, 1.5);
    return max(columns, isoline_cover(inside.y, f32(side), slopes.y, 1.5));
}

fn tinted(color: vec3<f32>, ground: Ground, ray: Ray, t: f32, detail: u32) -> vec3<f32> {
    var tint = color;
    if (has(ERROR)) { tint = heat_color(error_pixels(ground, ray, t) / style.error_limit); }
    if (has(LEVELS)) { tint = mix(tint, level_color(detail & 0xffu), 0.7); }
    if (has(NODES)) {
        let node = node_at(ground.point);
        if (((node.x ^ node.y) & 1) != 0) { tint *= 0.7; }
    }
    return tint;
}

fn lined(color: vec3<f32>, ground: Ground, detail: u32) -> vec3<f32> {
    var result = color;
    if (has(CONTOURS)) {
        let slope = length(vec2<f32>(ground.steps[0].z, ground.steps[1].z)) / frame.exaggeration;
        let tilt = length(ground.normal.xy) / ground.normal.z;
        result = over(result, CONTOUR_COLOR, contour_cover(ground.height, style.contour_interval, slope, tilt));
    }
    if (has(NODES)) { result = over(result, NODE_COLOR, node_border_cover(ground, node_at(ground.point).z)); }
    if (has(WIREFRAME)) {
        let distance = f32((detail >> 8u) & 0xffu) / 16.0;
        result = over(result, WIRE_COLOR, line_cover(distance, style.wireframe_width));
    }
    return result;
}

fn sunlight(ground: Ground) -> vec3<f32> {
    let facing = dot(ground.normal, style.light.sun);
    if (facing <= 0.0) { return vec3<f32>(0.0); }
    if (has(SHADOWS) && occluded(ground.position, style.light.sun)) { return vec3<f32>(0.0); }
    return style.light.sun_color * facing;
}

fn hazy(color: vec3<f32>, ground: Ground, ray: Ray) -> vec3<f32> {
    if (style.light.haze_density == 0.0) { return color; }
    let way = ground.position - ray.origin;
    let far = length(way);
    let through = haze_transmittance(
        style.light, frame.eye_height * frame.exaggeration, ground.height * frame.exaggeration, far);
    return mix(sky_color(style.light, vec3<f32>(way.xy / far, 0.0)), color, through);
}

fn shaded(ground: Ground, ray: Ray, t: f32, detail: u32) -> vec3<f32> {
    let color = tinted(base_color(ground), ground, ray, t, detail);
    if (!has(LIT)) { return lined(color, ground, detail); }
    let light = sunlight(ground) + ambient_light(style.light, ground.normal);
    return hazy(lined(color * light, ground, detail), ground, ray);
}

// Light and cover of one sample of a pixel.
fn sample_at(pixel: vec2<u32>) -> vec4<f32> {
    let ray = pixel_ray(pixel);
    let depth = surface_depth(pixel);
    if (depth > 0.0) {
        let t = view_depth(depth);
        return vec4<f32>(shaded(ground_at(ray, t), ray, t, surface_detail(pixel)), 1.0);
    }
    if (has(SKY)) { return vec4<f32>(sky_color(style.light, normalize(ray.direction)), 1.0); }
    return vec4<f32>(0.0);
}
