#include lod/bintree.wgsl
#include lod_vertex.wgsl

const SEGMENTS = #{SEGMENTS};   // that every edge of a bintree triangle is divided into

// Steps from the apex to both ends of the longest side; vertices are numbered row by row.
fn steps_of(vertex: u32) -> vec2<i32> {
    let row = SEGMENTS + 1;
    return vec2<i32>(i32(vertex) % row, i32(vertex) / row);
}

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let triangle = triangles[instance];
    let steps = steps_of(vertex);
    let one = corner_of(triangle, 1u) - triangle.apex;
    let other = corner_of(triangle, 2u) - triangle.apex;
    // in integers: triangles that share an edge agree on its vertices to the bit
    let away = (one * steps.x + other * steps.y) * (UNIT / SEGMENTS);
    let p = lattice_point(triangle.apex * UNIT + away);
    let at = vec2<f32>(steps);
    let lines = vec4<f32>(at, 0.5 * (at.x + at.y), 0.5 * (at.x - at.y));
    let level = drawn_level(p);
    return LodVertex(p, height_beyond(p), lines, id_of(triangle), level, level_of(triangle));
}
