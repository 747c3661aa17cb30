// The surface buffer of a picture: what is seen at each pixel, whatever drew it.
@group(2) @binding(0) var surface_depths: texture_2d<f32>;
@group(2) @binding(1) var surface_ids: texture_2d<u32>;
@group(2) @binding(2) var surface_details: texture_2d<u32>;

// Reverse z; 0 for the sky.
fn surface_depth(pixel: vec2<u32>) -> f32 { return textureLoad(surface_depths, pixel, 0).x; }

// Which part of the geometry: made of tile coordinates, the same each run.
fn surface_id(pixel: vec2<u32>) -> u32 { return textureLoad(surface_ids, pixel, 0).x; }

// Bits 0 to 7: level of the data; 8 to 15: sixteenths of a pixel to the nearest triangle edge, at most 255; 16 to 23:
// level of the tile.
fn surface_detail(pixel: vec2<u32>) -> u32 { return textureLoad(surface_details, pixel, 0).x; }
