// Work for its own sake.

@group(0) @binding(0) var<uniform> turns: vec4u;
@group(0) @binding(1) var<storage, read_write> sink: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    var x = f32(id.x) * 1e-6;
    for (var turn = 0u; turn < turns.x; turn++) {
        x = fma(x, 0.999, 0.001);
    }
    // never so, which the compiler cannot know
    if x > 2.0 {
        sink[0] = x;
    }
}
