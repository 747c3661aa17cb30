#include corners.wgsl
#include visibility.wgsl
// One meshlet or block of triangles per workgroup: a meshlet's vertices once each, then every triangle. Large ones and
// those to be clipped are put off.

const RASTER_SMALL = 16;          // pixels along a side up to which a triangle is drawn by one invocation
const RASTER_ROW = 4096u;         // workgroups along the first axis of the dispatch
const RASTER_GROUP = #{RASTER_GROUP}u;

var<workgroup> raster_positions: array<vec2<i32>, RASTER_VERTICES>;
var<workgroup> raster_places: array<vec3<f32>, RASTER_VERTICES>;       // pixels and reverse-z depth
var<workgroup> raster_codes: array<u32, RASTER_VERTICES>;

@compute @workgroup_size(RASTER_GROUP)
fn draw_meshlets(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let within = group.y * RASTER_ROW + group.x;
    if (within >= raster_batch.count) { return; }
    let number = raster_batch.first + within;
    let place = raster_place_of(number);
    if (RASTER_KIND == RASTER_MESHES) {
        let vertices = raster_triangles[place.start];
        for (var i = local; i < vertices; i += RASTER_GROUP) {
            raster_keep(i, lod_vertex(raster_triangles[place.start + 2u + i] + place.base_vertex, place.instance));
        }
        workgroupBarrier();
        for (var i = local; i < place.count; i += RASTER_GROUP) {
            raster_draw_triangle(raster_locals_of(place, i), (number << RASTER_BITS) | i);
        }
    } else if (local < place.count) {
        let corners = raster_corners_of(place, local);
        for (var i = 0u; i < 3u; i += 1u) { raster_keep(3u * local + i, lod_vertex(corners[i], place.instance)); }
        raster_draw_triangle(3u * local + vec3<u32>(0u, 1u, 2u), (number << RASTER_BITS) | local);
    }
}

fn raster_keep(at: u32, v: LodVertex) {
    let clip = raster_clip_of(v);
    raster_codes[at] = raster_outcode(clip) | raster_rim_code(v.point);
    raster_positions[at] = raster_fixed_position(clip);
    raster_places[at] = vec3<f32>(raster_pixel_position(clip), clip.z / clip.w);
}

fn raster_draw_triangle(corners: vec3<u32>, triangle: u32) {
    let codes3 = vec3<u32>(raster_codes[corners.x], raster_codes[corners.y], raster_codes[corners.z]);
    if ((codes3.x & codes3.y & codes3.z & 31u) != 0u) { return; }
    let any_code = codes3.x | codes3.y | codes3.z;
    if ((any_code & RASTER_CLIP) != 0u) {
        raster_put_off(triangle);
        return;
    }
    let a = raster_positions[corners.x];
    var b = raster_positions[corners.y];
    var c = raster_positions[corners.z];
    let low = max((min(min(a, b), c) + 127) >> vec2<u32>(8u), vec2<i32>(0));
    let high = min((max(max(a, b), c) - 128) >> vec2<u32>(8u), vec2<i32>(frame.size) - 1);
    // most triangles of a pixel's size miss all pixel centres
    if (any(low > high)) { return; }
    if (any(max(max(a, b), c) - min(min(a, b), c) > vec2<i32>(RASTER_SMALL * 256))) {
        raster_put_off(triangle);
        return;
    }
    let ab = b - a;
    let ac = c - a;
    let area = ab.x * ac.y - ab.y * ac.x;
    if (area == 0) { return; }
    // undersides are drawn too
    let turned = area < 0;
    if (turned) {
        let swap = b;
        b = c;
        c = swap;
    }
    let plane = raster_depth_plane(raster_places[corners.x], raster_places[corners.y], raster_places[corners.z]);
    let doubtful = !RASTER_COVERED || (any_code & RASTER_RIM) != 0u;
    let ba = b - a;
    let cb = c - b;
    let ca = a - c;
    let bias = vec3<i32>(select(-1, 0, raster_owns_edge(ba)), select(-1, 0, raster_owns_edge(cb)), select(-1, 0, raster_owns_edge(ca)));
    for (var y = low.y; y <= high.y; y += 1) {
        for (var x = low.x; x <= high.x; x += 1) {
            let p = vec2<i32>(x, y) * 256 + 128;
            let pa = p - a;
            let pb = p - b;
            let pc = p - c;
            let of_c = ba.x * pa.y - ba.y * pa.x;
            let of_a = cb.x * pb.y - cb.y * pb.x;
            let of_b = ca.x * pc.y - ca.y * pc.x;
            if (any(vec3<i32>(of_c, of_a, of_b) + bias < vec3<i32>(0))) { continue; }
            let pixel = vec2<u32>(vec2<i32>(x, y));
            let depth = raster_depth_at(plane, vec2<f32>(pixel) + 0.5);
            if (doubtful && !raster_is_ground(pixel, depth)) { continue; }
            raster_show(pixel, depth, triangle);
        }
    }
}

fn raster_put_off(triangle: u32) {
    let at = atomicAdd(&raster_queues.large, 1u);
    if (at < arrayLength(&raster_large)) { raster_large[at] = triangle; }
}
