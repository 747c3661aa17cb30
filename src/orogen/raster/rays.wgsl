#include frame.wgsl
#include ray_hit.wgsl
// One ray per pixel, from the algorithm's `lod_ray`; what is nearer than the surface so far replaces it. The FIRST pass of
// a picture without patches has no surface so far, and writes the sky too. A pass that REPLACEs casts rays where the
// algorithm asks for it (replace.wgsl), and writes what they find, nearer or not.

const FIRST = #{FIRST};
const REPLACE = #{REPLACE};

@group(2) @binding(0) var surface_depths: texture_storage_2d<r32float, read_write>;
@group(2) @binding(1) var surface_ids: texture_storage_2d<r32uint, read_write>;
@group(2) @binding(2) var surface_details: texture_storage_2d<r32uint, read_write>;

@compute @workgroup_size(8, 8)
fn cast_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    take_blocks();
    if (any(id.xy >= frame.size)) { return; }
    if (!should_cast(id.xy)) { return; }
    let orthographic = frame.forward.w > 0.5;
    let ray = pixel_ray(id.xy);
    var drawn = 0.0;
    if (!FIRST && !REPLACE) { drawn = textureLoad(surface_depths, id.xy).x; }
    var end = select(1e30, frame.depth_far, orthographic);
    if (drawn > 0.0) { end = view_depth(drawn); }
    let start = select(frame.near, frame.depth_near, orthographic);
    let hit = lod_ray(ray, start, end);
    let found = hit.t >= start;
    if (!FIRST && !REPLACE && !found) { return; }
    let detail = pack_detail(hit.level, hit.tile_level, hit.edge);
    textureStore(surface_depths, id.xy, vec4<f32>(select(0.0, depth_of(hit.t), found)));
    textureStore(surface_ids, id.xy, vec4<u32>(select(0u, hit.id, found)));
    textureStore(surface_details, id.xy, vec4<u32>(select(0u, detail, found)));
}
