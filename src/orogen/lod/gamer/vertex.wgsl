#include gamer.wgsl
#include lod_vertex.wgsl
// Tessellation by barycentric interpolation, then displacement. A vertex number holds the weights (patterns.py).

const MOST = #{MOST}u;

@group(1) @binding(1) var<storage, read> starts: array<u32>;
@group(1) @binding(2) var<storage, read> instances: array<u32>;  // triangle << 9 | deepest edge << 6 | corner order

// Without rounding, so that the corners' order does not matter, and a point of an edge is the same from both sides.
fn interpolated(a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, weights: vec2<i32>) -> Point {
    let along = a - c;
    let across = b - c;
    let rest = (along & vec2<i32>((1 << MOST) - 1)) * weights.x + (across & vec2<i32>((1 << MOST) - 1)) * weights.y;
    let whole = (along >> vec2<u32>(MOST)) * weights.x + (across >> vec2<u32>(MOST)) * weights.y;
    let fraction = vec2<f32>(rest & vec2<i32>((1 << MOST) - 1)) / f32(1 << MOST);
    return Point(c + whole + (rest >> vec2<u32>(MOST)), fraction);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let word = instances[starts[vertex >> #{PATTERN}u] + instance];
    var corners = corners_of(word >> 9u);
    let a = lattice_point(corners[word & 3u]);
    let b = lattice_point(corners[(word >> 2u) & 3u]);
    let c = lattice_point(corners[(word >> 4u) & 3u]);
    let weights = vec2<i32>(vec2<u32>(vertex, vertex >> #{SECOND}u) & vec2<u32>(255u));
    let p = interpolated(a, b, c, weights);
    let corner = (vertex >> #{CORNER}u) & 3u;
    let lines = vec4<f32>(vec3<f32>(vec3<u32>(corner) == vec3<u32>(0u, 1u, 2u)), 0.5);
    let deepest = (word >> 6u) & 7u;
    return LodVertex(p, height_at(p), lines, word >> 9u, drawn_level(p), MOST - deepest);
}
