#include frame.wgsl
#include lod_vertex.wgsl
// Skirts close what gapes where chunks of different detail meet.

// The lower end of a skirt under a vertex: `side` 1 to 4 is west, east, north, south, `drop` metres of the data. It leans
// outwards by a sixteenth of a pixel and hangs down a little more than it must, so that it also closes the slits that
// rounding leaves where edges meet without sharing vertices.
fn hang(top: LodVertex, side: u32, drop: f32) -> LodVertex {
    let depth = max(dot(frame.forward.xyz, lift(flat_position(top.point), top.height)), frame.near);
    let pixel = 1.0 / pixels_per_metre(depth);
    let sign = select(-1.0, 1.0, (side & 1u) == 0u);
    let outwards = select(vec2<f32>(0.0, sign), vec2<f32>(sign, 0.0), side <= 2u);
    let leant = top.point.frac + outwards * (pixel / (16.0 * length(to_metres(outwards))));
    let whole = floor(leant);
    var low = top;
    low.point = Point(top.point.cell + vec2<i32>(whole), leant - whole);
    // never below what there is: the lowest ground must stay the lowest
    low.height = max(top.height - drop - pixel / (128.0 * frame.exaggeration), min(top.height, frame.height_min));
    low.lines = vec4<f32>(0.5);
    return low;
}
