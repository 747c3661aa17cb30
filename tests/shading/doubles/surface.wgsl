#include frame.wgsl
// Stand-in for the surface buffer: rows of pixels.
@group(2) @binding(0) var<storage, read> depths: array<f32>;
@group(2) @binding(1) var<storage, read> details: array<u32>;

fn surface_depth(pixel: vec2<u32>) -> f32 { return depths[pixel.y * frame.size.x + pixel.x]; }
fn surface_detail(pixel: vec2<u32>) -> u32 { return details[pixel.y * frame.size.x + pixel.x]; }
