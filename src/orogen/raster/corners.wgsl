#include frame.wgsl
#include lod_vertex.wgsl
#include clipmap.wgsl
// Vertices and triangles of meshlets as the compute rasteriser sees them.

const RASTER_MESHES = 0u;                        // meshlets, whose vertices are computed once
const RASTER_LISTS = 1u;                         // triangle lists and strips without an index list: blocks of triangles
const RASTER_STRIPS = 2u;
const RASTER_KIND = #{RASTER_KIND}u;
const RASTER_TRIANGLES = #{RASTER_TRIANGLES}u;         // of a workgroup, at most
const RASTER_VERTICES = #{RASTER_VERTICES}u;           // that it computes
const RASTER_MESHLET_WORDS = 2u + RASTER_VERTICES + RASTER_TRIANGLES;
const RASTER_BITS = #{RASTER_BITS}u;                   // of a triangle's number, below those of its workgroup
const RASTER_MAX_DRAWS = #{RASTER_MAX_DRAWS}u;
const RASTER_SUBPIXELS = 256.0;                  // positions are rounded to 1/256 pixel, as hardware does
const RASTER_GUARD = 131072.0;                   // pixels from the picture's corner that fixed point has room for
const RASTER_COVERED = #{RASTER_COVERED};               // every sample is valid
const RASTER_NEAR = 16u;                         // outcode: bits 0 to 3 outside a side of the picture, this one before the near plane
const RASTER_CLIP = 32u;                         // does not fit fixed point as it is
const RASTER_RIM = 64u;                          // so near the data's outline that rounding may cross it, or beyond

struct RasterDrawRecord {
    first: u32,             // number of its first workgroup
    first_meshlet: u32,
    groups: u32,            // workgroups an instance
    instances: u32,
    base_vertex: u32,
    triangles: u32,         // an instance
}

// Draws of one module and mesh. Workgroups are numbered through all batches of a picture.
struct RasterBatch { first: u32, count: u32, draws: u32, unused: u32, records: array<RasterDrawRecord, RASTER_MAX_DRAWS> }

@group(2) @binding(0) var<storage, read> raster_batch: RasterBatch;
@group(2) @binding(1) var<storage, read> raster_triangles: array<u32>;   // meshlets

// A workgroup's triangles.
struct RasterPlace {
    start: u32,             // word of the meshlet
    first: u32,             // first triangle of the instance
    count: u32,
    instance: u32,
    base_vertex: u32,
}

fn raster_place_of(number: u32) -> RasterPlace {
    var draw = 0u;
    for (var i = 1u; i < raster_batch.draws; i += 1u) {
        if (number >= raster_batch.records[i].first) { draw = i; }
    }
    let record = raster_batch.records[draw];
    let within = number - record.first;
    let group = within % record.groups;
    let instance = within / record.groups;
    if (RASTER_KIND == RASTER_MESHES) {
        let start = (record.first_meshlet + group) * RASTER_MESHLET_WORDS;
        return RasterPlace(start, 0u, raster_triangles[start + 1u], instance, record.base_vertex);
    }
    let first = group * RASTER_TRIANGLES;
    return RasterPlace(0u, first, min(RASTER_TRIANGLES, record.triangles - first), instance, record.base_vertex);
}

// Numbers of a triangle's vertices, the first of which tells id and levels.
fn raster_corners_of(place: RasterPlace, triangle: u32) -> vec3<u32> {
    if (RASTER_KIND == RASTER_MESHES) {
        let l = raster_locals_of(place, triangle);
        let at = place.start + 2u;
        return vec3<u32>(raster_triangles[at + l.x], raster_triangles[at + l.y], raster_triangles[at + l.z]) + place.base_vertex;
    }
    let t = place.first + triangle;
    if (RASTER_KIND == RASTER_STRIPS) {
        return place.base_vertex + t + vec3<u32>(0u, 1u + (t & 1u), 2u - (t & 1u));
    }
    return place.base_vertex + 3u * t + vec3<u32>(0u, 1u, 2u);
}

// Places of a triangle's corners among the meshlet's vertices.
fn raster_locals_of(place: RasterPlace, triangle: u32) -> vec3<u32> {
    let packed = raster_triangles[place.start + 2u + RASTER_VERTICES + triangle];
    return vec3<u32>(packed & 1023u, (packed >> 10u) & 1023u, packed >> 20u);
}

// Clip coordinates of a vertex.
fn raster_clip_of(v: LodVertex) -> vec4<f32> {
    return frame.view_projection * vec4<f32>(lift(flat_position(v.point), v.height), 1.0);
}

// Pixels (x right, y down) of a point in front of the eye.
fn raster_pixel_position(clip: vec4<f32>) -> vec2<f32> {
    return (clip.xy / clip.w * vec2<f32>(0.5, -0.5) + 0.5) * vec2<f32>(frame.size);
}

fn raster_fixed_position(clip: vec4<f32>) -> vec2<i32> {
    return vec2<i32>(round(raster_pixel_position(clip) * RASTER_SUBPIXELS));
}

// Depth as a plane through a corner (pixels, depth). Pixels up to 1/256 beside the triangle belong to it: the plane goes on
// there, but no farther than the corners' depths are apart, for that of a sliver may be steep.
struct RasterDepthPlane { origin: vec3<f32>, slope: vec2<f32>, low: f32, high: f32 }

// Corners are not rounded here, so that surfaces are not tilted.
fn raster_depth_plane(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> RasterDepthPlane {
    let ab = b - a;
    let ac = c - a;
    let area = ab.x * ac.y - ab.y * ac.x;
    var slope = vec2<f32>(0.0);
    if (area != 0.0) { slope = vec2<f32>(ab.z * ac.y - ac.z * ab.y, ac.z * ab.x - ab.z * ac.x) / area; }
    let low = min(min(a.z, b.z), c.z);
    let high = max(max(a.z, b.z), c.z);
    return RasterDepthPlane(a, slope, 2.0 * low - high, 2.0 * high - low);
}

fn raster_depth_at(plane: RasterDepthPlane, pixel: vec2<f32>) -> f32 {
    return clamp(plane.origin.z + dot(plane.slope, pixel - plane.origin.xy), plane.low, plane.high);
}

fn raster_outcode(clip: vec4<f32>) -> u32 {
    let guard = 2.0 * RASTER_GUARD / f32(max(frame.size.x, frame.size.y)) - 2.0;
    var code = select(0u, 1u, clip.x < -clip.w) | select(0u, 2u, clip.x > clip.w);
    code |= select(0u, 4u, clip.y < -clip.w) | select(0u, 8u, clip.y > clip.w);
    code |= select(0u, RASTER_NEAR, clip.z > clip.w);
    let fits = clip.w > 0.0 && all(abs(clip.xy) <= vec2<f32>(guard * clip.w));
    return code | select(RASTER_CLIP, 0u, fits && clip.z <= clip.w);
}

// RASTER_RIM, or 0 for a point that lies inside by more than 1/256 of its distance: positions are rounded.
fn raster_rim_code(p: Point) -> u32 {
    let away = abs(p.cell - frame.anchor);
    let margin = max(away.x, away.y) >> 8u;
    let inside = all(p.cell > frame.extent.xy + margin) && all(p.cell < frame.extent.zw - margin);
    return select(RASTER_RIM, 0u, inside);
}

// Whether what lies at a depth in a pixel is terrain.
fn raster_is_ground(pixel: vec2<u32>, depth: f32) -> bool {
    let ray = pixel_ray(pixel);
    let offset = to_subtexels((ray.origin + ray.direction * view_depth(depth)).xy) + frame.eye_offset;
    let slack = 0.125 + 1e-6 * abs(offset);
    let low = vec2<f32>(frame.extent.xy - frame.anchor) - slack;
    let high = vec2<f32>(frame.extent.zw - frame.anchor) + slack;
    if (any(offset < low) || any(offset > high)) { return false; }
    return RASTER_COVERED || coverage_at(point_at(offset)) >= 0.5;
}

// Pixels on this edge belong to the triangle: top and left edges of triangles that run clockwise on screen.
fn raster_owns_edge(edge: vec2<i32>) -> bool { return edge.y < 0 || (edge.y == 0 && edge.x > 0); }
