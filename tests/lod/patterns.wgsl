#include pattern.wgsl
// Patterns of many factors, for comparison.

struct Factors { outer: vec4<f32>, inner: vec2<f32> }

@group(0) @binding(0) var<storage, read> factors: array<Factors>;
@group(0) @binding(1) var<storage, read_write> counts: array<vec2<u32>>;    // points and triangles
@group(0) @binding(2) var<storage, read_write> corners: array<vec2<u32>>;   // parameters, 3 * ROOM for each pattern

const ROOM = #{ROOM}u;

@compute @workgroup_size(64)
fn write_patterns(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    var pattern = pattern_of(factors[group.x].outer, factors[group.x].inner);
    counts[group.x] = vec2<u32>(pattern.points, pattern.triangles);
    for (var n = thread; n < pattern.triangles; n += 64u) {
        let triangle = triangle_of(&pattern, n);
        for (var k = 0u; k < 3u; k += 1u) {
            corners[(group.x * ROOM + n) * 3u + k] = parameters(&pattern, triangle[k]);
        }
    }
}
