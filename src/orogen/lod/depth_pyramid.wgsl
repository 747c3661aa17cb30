#include lod/depth_cells.wgsl
// Whether a box lies behind what a depth pyramid has seen.

@group(1) @binding(4) var<storage, read> depth_cells: array<f32>;

const MOST_CELLS = 16u;   // looked at along a side

// `low`, `high`: of the box around what may be drawn, camera-relative metres. `projection`: these to the clip space that
// the pyramid's depths were seen in. No triangle in the box is longer or wider than one of `parts` of it.
fn is_hidden(low: vec3<f32>, high: vec3<f32>, parts: f32, projection: mat4x4<f32>) -> bool {
    var from_pixel = vec2<f32>(1e30);
    var to_pixel = vec2<f32>(-1e30);
    var nearest = 0.0;
    var farthest = 1.0;
    var upright = 0.0;
    var depths: array<f32, 8>;
    for (var i = 0u; i < 8u; i += 1u) {
        let corner = select(low, high, (vec3<u32>(i) & vec3<u32>(1u, 2u, 4u)) != vec3<u32>(0u));
        let clip = projection * vec4<f32>(corner, 1.0);
        // in front of the near plane, or behind the eye
        if (clip.w <= 0.0 || clip.z >= clip.w) { return false; }
        let pixel = (clip.xy / clip.w * vec2<f32>(0.5, -0.5) + 0.5) * vec2<f32>(frame.size);
        from_pixel = min(from_pixel, pixel);
        to_pixel = max(to_pixel, pixel);
        depths[i] = clip.z / clip.w;
        nearest = max(nearest, depths[i]);
        farthest = min(farthest, depths[i]);
        if (i > 3u) { upright = max(upright, abs(depths[i] - depths[i - 4u])); }
    }
    // pixels whose centres it may cover; rounding must not hide one
    let last = vec2<f32>(frame.size) - 1.0;
    let first_pixel = ceil(from_pixel - 0.55);
    let last_pixel = floor(to_pixel - 0.45);
    if (any(last_pixel < first_pixel)) { return true; }
    if (any(last_pixel < vec2<f32>(0.0)) || any(first_pixel > last)) { return false; }
    let a = vec2<u32>(clamp(first_pixel, vec2<f32>(0.0), last));
    let b = vec2<u32>(clamp(last_pixel, vec2<f32>(0.0), last));
    // where a pixel's centre lies beside a triangle by rounding, its depth may be as far from the corners' as these are apart
    nearest += (upright + (nearest - farthest) / parts) * (nearest / max(farthest, 1e-30));
    nearest += 1e-5 * nearest + select(0.0, 1e-5, frame.forward.w > 0.5);
    var level = 1u;
    while (any((b >> vec2<u32>(2u * level)) - (a >> vec2<u32>(2u * level)) >= vec2<u32>(MOST_CELLS))) { level += 1u; }
    let shift = vec2<u32>(2u * level);
    let from_cell = a >> shift;
    let to_cell = b >> shift;
    let start = first_cell(level);
    let row = cells_of(level).x;
    for (var y = from_cell.y; y <= to_cell.y; y += 1u) {
        for (var x = from_cell.x; x <= to_cell.x; x += 1u) {
            if (depth_cells[start + y * row + x] <= nearest) { return false; }
        }
    }
    return true;
}
