#include clipmap.wgsl
// Geometry images (Schmiade 2008, section 2.4): a pixel is a point of the ground and says how important it is.

const SKETCH_SIZE = #{SKETCH_SIZE}u;     // pixels along a side of the sketch map

struct Settings {
    columns: u32,           // cells along the mesh's axes
    rows: u32,
    along_x: u32,           // 1: rows of the images run along the data's rows, 0: along its columns
    nearest: f32,           // metres: what is nearer to the eye is no more important
}

// Subtexels from the anchor, metres of the data, importance.
struct Pixel { at: vec2<f32>, height: f32, importance: f32 }

@group(1) @binding(0) var<uniform> settings: Settings;

fn ground_of(pixel: Pixel) -> Point { return clamp_to_extent(point_at(pixel.at)); }
