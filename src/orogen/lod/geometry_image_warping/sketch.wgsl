#include image.wgsl
// The sketch map: the rectangle around the frustum, and what is important in it.

const OUTSIDE = #{OUTSIDE};              // importance of what is far outside the picture
const BACK = #{BACK};                    // importance of what faces away
const FALL = #{FALL};                    // sine of the angle outside the picture over which importance falls to 1/e

@group(1) @binding(1) var<storage, read_write> sketch: array<Pixel>;
@group(1) @binding(2) var<storage, read> lattice: array<vec2<f32>>;   // x of columns and y of rows

@compute @workgroup_size(8, 8)
fn start(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= vec2<u32>(SKETCH_SIZE))) { return; }
    let k = select(id.yx, id.xy, settings.along_x == 1u);
    sketch[id.y * SKETCH_SIZE + id.x] = Pixel(vec2<f32>(lattice[k.x].x, lattice[k.y].y), 0.0, 1.0);
}

// Metres to the neighbour in a row (or a column), at the end to the one before.
fn step_from(at: vec2<u32>, ahead: vec2<u32>) -> vec2<f32> {
    let next = select(at + ahead, at - ahead, any(at + ahead >= vec2<u32>(SKETCH_SIZE)));
    return to_metres(sketch[next.y * SKETCH_SIZE + next.x].at - sketch[at.y * SKETCH_SIZE + at.x].at);
}

// How much less a surface matters that turns its back on the eye; `facing`: cosine from its normal to the eye.
fn orientation(facing: f32) -> f32 { return mix(BACK, 1.0, smoothstep(-0.5, 0.0, facing)); }

// How much less matters what lies outside the picture, by the sine of the angle to it. What is as near to the picture
// as the neighbours are may be in it.
fn in_picture(position: vec3<f32>, steps: mat2x2<f32>, away: f32) -> f32 {
    var outside = 0.0;
    for (var i = 0u; i < 5u; i += 1u) {
        let plane = frame.planes[i];
        let reach = abs(dot(plane.xy, steps[0])) + abs(dot(plane.xy, steps[1]));
        outside = max(outside, -dot(plane.xyz, position) - plane.w - reach);
    }
    return max(OUTSIDE, exp(-outside / (FALL * away)));
}

@compute @workgroup_size(8, 8)
fn weigh(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= vec2<u32>(SKETCH_SIZE))) { return; }
    let k = id.y * SKETCH_SIZE + id.x;
    let p = ground_of(sketch[k]);
    let steps = mat2x2<f32>(step_from(id.xy, vec2<u32>(1u, 0u)), step_from(id.xy, vec2<u32>(0u, 1u)));
    let level = u32(log2(max(max(length(steps[0]), length(steps[1])) / frame.spacing, 1.0)));
    let height = height_at_level(p, level);
    let position = lift(flat_position(p), height);
    let to_eye = frame.lod_eye - position;
    let away = max(length(to_eye), settings.nearest);
    let slope = gradient_at(p, f32(level));
    let facing = dot(normalize(vec3<f32>(-slope, 1.0)), to_eye) / away;
    sketch[k].height = height;
    sketch[k].importance = orientation(facing) * in_picture(position, steps, away) / away;
}
