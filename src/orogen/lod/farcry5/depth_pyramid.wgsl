#include pyramid_cells.wgsl
#include box.wgsl
// Whether a box lies behind what a depth pyramid has seen.

@group(1) @binding(4) var<storage, read> depth_cells: array<f32>;

const MOST_CELLS = 16u;   // looked at along a side

// `projection`: camera-relative metres to the clip space that the pyramid's depths were seen in.
fn is_hidden(box: Box, projection: mat4x4<f32>) -> bool {
    var low = vec2<f32>(1e30);
    var high = vec2<f32>(-1e30);
    var nearest = 0.0;
    for (var i = 0u; i < 8u; i += 1u) {
        let corner = select(box.low, box.high, (vec3<u32>(i) & vec3<u32>(1u, 2u, 4u)) != vec3<u32>(0u));
        let clip = projection * vec4<f32>(corner, 1.0);
        // in front of the near plane, or behind the eye
        if (clip.w <= 0.0 || clip.z >= clip.w) { return false; }
        let pixel = (clip.xy / clip.w * vec2<f32>(0.5, -0.5) + 0.5) * vec2<f32>(frame.size);
        low = min(low, pixel);
        high = max(high, pixel);
        nearest = max(nearest, clip.z / clip.w);
    }
    // rounding must not hide what touches a pixel, nor what is as near as what was drawn
    let last = vec2<f32>(frame.size) - 1.0;
    let first_pixel = floor(low - 0.05);
    let last_pixel = floor(high + 0.05);
    if (any(last_pixel < vec2<f32>(0.0)) || any(first_pixel > last)) { return false; }
    let a = vec2<u32>(clamp(first_pixel, vec2<f32>(0.0), last));
    let b = vec2<u32>(clamp(last_pixel, vec2<f32>(0.0), last));
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
