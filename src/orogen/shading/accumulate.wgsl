#include shade.wgsl
// One thread a pixel adds a sample to the sums of light and cover, row by row.

const FIRST = #{FIRST};         // of the picture's samples: what the sums held does not count

@group(1) @binding(2) var<storage, read_write> accumulated: array<vec4<f32>>;

@compute @workgroup_size(8, 8)
fn accumulate(@builtin(global_invocation_id) id: vec3<u32>) {
    take_blocks();
    if (any(id.xy >= frame.size)) { return; }
    var light = sample_at(id.xy);
    let at = id.y * frame.size.x + id.x;
    if (!FIRST) { light += accumulated[at]; }
    accumulated[at] = light;
}
