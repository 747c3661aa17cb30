#include corners.wgsl
#include visibility.wgsl
// Triangles that are large or have to be clipped: at most eight corners after clipping to the near plane and the guard.

const RASTER_BLOCK = 32;          // pixels along a block's side
const RASTER_MOST = 9u;

// A triangle ready for pixels: corners in subpixels, clockwise on screen.
struct RasterPiece {
    depth: vec3<f32>,       // as a linear function of (x, y, 1) in the picture from -1 to 1
    triangle: u32,
    positions: array<vec2<i32>, 3>,
    low: f32,               // depths that pixels may have
    high: f32,
}

struct RasterBlock { piece: u32, place: u32 }

@group(2) @binding(5) var<storage, read_write> raster_pieces: array<RasterPiece>;
@group(2) @binding(6) var<storage, read_write> raster_blocks: array<RasterBlock>;

struct RasterPolygon {
    count: u32,
    depth: vec3<f32>,
    clip: array<vec4<f32>, RASTER_MOST>,
}

fn raster_clip_distance(clip: vec4<f32>, plane: u32) -> f32 {
    let guard = (2.0 * RASTER_GUARD / f32(max(frame.size.x, frame.size.y)) - 2.0) * clip.w;
    switch (plane) {
        case 0u: { return clip.w - clip.z; }
        case 1u: { return guard - clip.x; }
        case 2u: { return guard + clip.x; }
        case 3u: { return guard - clip.y; }
        default: { return guard + clip.y; }
    }
}

// Sutherland and Hodgman 1974. A cut is computed from its inner end, so that triangles on both sides of an edge agree.
fn raster_clipped(triangle: u32) -> RasterPolygon {
    let place = raster_place_of(triangle >> RASTER_BITS);
    let corners = raster_corners_of(place, triangle & ((1u << RASTER_BITS) - 1u));
    var polygon: RasterPolygon;
    polygon.count = 3u;
    for (var i = 0u; i < 3u; i += 1u) {
        polygon.clip[i] = raster_clip_of(lod_vertex(corners[i], place.instance));
    }
    let depth = raster_linear_depth(polygon.clip[0], polygon.clip[1], polygon.clip[2]);
    for (var plane = 0u; plane < 5u; plane += 1u) {
        var result: RasterPolygon;
        result.count = 0u;
        for (var i = 0u; i < polygon.count; i += 1u) {
            let j = select(i + 1u, 0u, i + 1u == polygon.count);
            let here = raster_clip_distance(polygon.clip[i], plane);
            let there = raster_clip_distance(polygon.clip[j], plane);
            if (here >= 0.0) {
                result.clip[result.count] = polygon.clip[i];
                result.count += 1u;
            }
            if ((here >= 0.0) != (there >= 0.0)) {
                let inner = select(j, i, here >= 0.0);
                let outer = select(i, j, here >= 0.0);
                let from_inner = select(there, here, here >= 0.0);
                let way = from_inner / (from_inner - select(here, there, here >= 0.0));
                result.clip[result.count] = polygon.clip[inner] + way * (polygon.clip[outer] - polygon.clip[inner]);
                result.count += 1u;
            }
        }
        polygon = result;
        if (polygon.count < 3u) { break; }
    }
    polygon.depth = depth;
    return polygon;
}

fn raster_cross64(a: vec2<i32>, b: vec2<i32>) -> i64 { return i64(a.x) * i64(b.y) - i64(a.y) * i64(b.x); }

// The depth of a triangle's plane as a linear function of (x, y, 1): from the corners as they are, so that rounding to
// subpixels does not tilt it.
fn raster_linear_depth(a: vec4<f32>, b: vec4<f32>, c: vec4<f32>) -> vec3<f32> {
    let ab = b - a;
    let ac = c - a;
    let normal = cross(ab.xyw, ac.xyw);
    return (a.z * normal + ab.z * cross(ac.xyw, a.xyw) + ac.z * cross(a.xyw, ab.xyw)) / dot(normal, a.xyw);
}
