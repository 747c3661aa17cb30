#include corners.wgsl
#include ray_hit.wgsl
// From the triangle that is seen at each pixel to the surface buffer.

const RASTER_FIRST = #{RASTER_FIRST};    // of a picture's batches: writes the sky too
const RASTER_EDGES = #{RASTER_EDGES};    // whether distances to edges are worked out; else they are the greatest

@group(2) @binding(2) var<storage, read> raster_visibility: array<u64>;
@group(3) @binding(0) var surface_depths: texture_storage_2d<r32float, read_write>;
@group(3) @binding(1) var surface_ids: texture_storage_2d<r32uint, read_write>;
@group(3) @binding(2) var surface_details: texture_storage_2d<r32uint, read_write>;

@compute @workgroup_size(8, 8)
fn show_visibility(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= frame.size)) { return; }
    let seen = raster_visibility[id.y * frame.size.x + id.x];
    let depth = bitcast<f32>(u32(seen >> 32u));
    let triangle = u32(seen & 0xfffffffflu);
    let number = triangle >> RASTER_BITS;
    let own = depth > 0.0 && number >= raster_batch.first && number < raster_batch.first + raster_batch.count;
    if (!own) {
        if (RASTER_FIRST && depth == 0.0) {
            textureStore(surface_depths, id.xy, vec4<f32>(0.0));
            textureStore(surface_ids, id.xy, vec4<u32>(0u));
            textureStore(surface_details, id.xy, vec4<u32>(0u));
        }
        return;
    }
    let place = raster_place_of(number);
    let corners = raster_corners_of(place, triangle & ((1u << RASTER_BITS) - 1u));
    let v = lod_vertex(corners.x, place.instance);
    var edge = 16.0;
    if (RASTER_EDGES) { edge = raster_edge_distance(place.instance, corners, vec2<f32>(id.xy) + 0.5); }
    textureStore(surface_depths, id.xy, vec4<f32>(depth));
    textureStore(surface_ids, id.xy, vec4<u32>(v.id));
    textureStore(surface_details, id.xy, vec4<u32>(pack_detail(v.level, v.tile_level, edge)));
}

// The lines of the triangle's corners and 1 / w, as functions of the pixel: homogeneous, so that corners behind the eye
// do no harm (Olano and Greer 1997).
fn raster_edge_distance(instance: u32, corners: vec3<u32>, pixel: vec2<f32>) -> f32 {
    var clips: array<vec3<f32>, 3>;
    var lines: array<vec4<f32>, 3>;
    for (var i = 0u; i < 3u; i += 1u) {
        let v = lod_vertex(corners[i], instance);
        clips[i] = raster_clip_of(v).xyw;
        lines[i] = v.lines;
    }
    let here = raster_lines_at(clips, lines, pixel);
    let dx = raster_lines_at(clips, lines, pixel + vec2<f32>(0.5, 0.0)) - raster_lines_at(clips, lines, pixel - vec2<f32>(0.5, 0.0));
    let dy = raster_lines_at(clips, lines, pixel + vec2<f32>(0.0, 0.5)) - raster_lines_at(clips, lines, pixel - vec2<f32>(0.0, 0.5));
    let away = abs(fract(here + 0.5) - 0.5) / max(sqrt(dx * dx + dy * dy), vec4<f32>(1e-6));
    return min(min(away.x, away.y), min(away.z, away.w));
}

fn raster_lines_at(clips: array<vec3<f32>, 3>, lines: array<vec4<f32>, 3>, pixel: vec2<f32>) -> vec4<f32> {
    let ndc = vec3<f32>((pixel / vec2<f32>(frame.size) * 2.0 - 1.0) * vec2<f32>(1.0, -1.0), 1.0);
    let a = dot(cross(clips[1], clips[2]), ndc);
    let b = dot(cross(clips[2], clips[0]), ndc);
    let c = dot(cross(clips[0], clips[1]), ndc);
    return (lines[0] * a + lines[1] * b + lines[2] * c) / (a + b + c);
}
