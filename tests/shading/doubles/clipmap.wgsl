#include frame.wgsl
// Stand-in for the clipmap: constants, and slopes that tell the level they were asked for.
const NODE_BITS = 8u;

struct Scene {
    gradient: vec2<f32>,
    gradient_per_level: vec2<f32>,
    lod: f32,
    resident: u32,
    error: f32,
    image_alpha: f32,
    shadow_east: f32,
}

@group(0) @binding(1) var<uniform> scene: Scene;

fn lod_at(p: Point) -> f32 { return scene.lod; }
fn resident_level(p: Point, level: u32) -> u32 { return max(level, scene.resident); }
fn gradient_at(p: Point, lod: f32) -> vec2<f32> { return scene.gradient + max(lod, 0.0) * scene.gradient_per_level; }
fn error_at(p: Point) -> f32 { return scene.error; }

// A picture of the footprint itself.
fn color_at(p: Point, footprint: mat2x2<f32>) -> vec4<f32> {
    return vec4<f32>(footprint[0], footprint[1].x, scene.image_alpha);
}
