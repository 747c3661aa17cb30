#include clipmap.wgsl
#include ray_hit.wgsl
// The hardware pipeline: vertices come from the algorithm's `lod_vertex`, fragments go to the surface buffer.

struct Corner {
    @invariant @builtin(position) position: vec4<f32>,
    @location(0) offset: vec2<f32>,                       // subtexels from the anchor
    @location(1) lines: vec4<f32>,
    @location(2) @interpolate(flat, either) words: vec3<u32>,   // id, level of the data, level of the tile
}

struct SurfaceTexel {
    @location(0) depth: f32,
    @location(1) id: u32,
    @location(2) detail: u32,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Corner {
    take_blocks();
    let v = lod_vertex(vertex, instance);
    let position = lift(flat_position(v.point), v.height);
    let offset = vec2<f32>(v.point.cell - frame.anchor) + v.point.frac;
    return Corner(frame.view_projection * vec4<f32>(position, 1.0), offset, v.lines, vec3<u32>(v.id, v.level, v.tile_level));
}

// Pixels to the nearest edge of the triangles.
fn edge_distance(lines: vec4<f32>) -> f32 {
    let dx = dpdx(lines);
    let dy = dpdy(lines);
    let away = abs(fract(lines + 0.5) - 0.5) / max(sqrt(dx * dx + dy * dy), vec4<f32>(1e-6));
    return min(min(away.x, away.y), min(away.z, away.w));
}

const RASTER_COVERED = #{RASTER_COVERED};         // every sample is valid

// Whether an offset from the anchor lies outside the data, by more than its rounding.
fn outside(offset: vec2<f32>) -> bool {
    let slack = 0.125 + 1e-6 * abs(offset);
    let low = vec2<f32>(frame.extent.xy - frame.anchor) - slack;
    let high = vec2<f32>(frame.extent.zw - frame.anchor) + slack;
    return any(offset < low) || any(offset > high);
}

@fragment
fn surface(in: Corner) -> SurfaceTexel {
    take_blocks();
    let edge = edge_distance(in.lines);
    // also where nothing overhangs: at the outline rounding to subpixels lets pixels in
    if (outside(in.offset)) { discard; }
    if (!RASTER_COVERED && coverage_at(point_at(in.offset)) < 0.5) { discard; }
    return SurfaceTexel(in.position.z, in.words.x, pack_detail(in.words.y, in.words.z, edge));
}
