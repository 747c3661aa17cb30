#include plane.wgsl
// The plane, in every other column of what has the id OF.

fn lod_replaces(pixel: vec2<u32>, depth: f32, id: u32, detail: u32) -> bool {
    return id == #{OF}u && (pixel.x & 1u) == 1u;
}
