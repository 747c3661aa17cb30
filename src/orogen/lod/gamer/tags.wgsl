#include gamer.wgsl
// Depth tags of the coarse mesh's vertices: how often edges near a vertex have to be halved. A vertex speaks for all
// triangles around it, so that the tags at an edge's two ends both know what the edge needs.

const TAG = #{TAG};                  // 0: from the distance, 1: from the curvature, 2: from the error
const MOST = f32(#{MOST});
const STEPS = 8;                     // samples along an edge, a power of two

@group(1) @binding(1) var<storage, read_write> vertices: array<CoarseVertex>;

fn vertex_number(corner: vec2<u32>) -> u32 { return corner.y * (gamer.cells.x + 1u) + corner.x; }

fn corner_of(vertex: u32) -> vec2<u32> {
    let columns = gamer.cells.x + 1u;
    return vec2<u32>(vertex % columns, vertex / columns);
}

@compute @workgroup_size(64)
fn measure_heights(@builtin(global_invocation_id) id: vec3<u32>) {
    let corner = corner_of(id.x);
    if (corner.y > gamer.cells.y) { return; }
    vertices[id.x].height = height_at(Point(lattice_point(corner), vec2<f32>(0.0)));
}

// Distance of the LOD eye to the box that holds the coarse vertices around one. The box is upright and has sides along
// rows and columns; with sheared axes its nearest point is only nearly that.
fn distance_around(first: vec2<u32>, last: vec2<u32>) -> f32 {
    let low = vec2<f32>(lattice_point(first) - frame.anchor) - frame.eye_offset;
    let high = vec2<f32>(lattice_point(last) - frame.anchor) - frame.eye_offset;
    let nearest = to_metres(clamp(to_subtexels(frame.lod_eye.xy), low, high));
    var bottom = 1e30;
    var top = -1e30;
    for (var y = first.y; y <= last.y; y += 1u) {
        for (var x = first.x; x <= last.x; x += 1u) {
            let corner = vec2<u32>(x, y);
            let flat = flat_position(Point(lattice_point(corner), vec2<f32>(0.0)));
            let z = lift(flat, vertices[vertex_number(corner)].height).z;
            bottom = min(bottom, z);
            top = max(top, z);
        }
    }
    let above = max(max(frame.lod_eye.z - top, bottom - frame.lod_eye.z), 0.0);
    return length(vec3<f32>(nearest - frame.lod_eye.xy, above));
}

// How far heights along a line lie off the chords between every `stride` of them, at most.
fn off_chords(line: ptr<function, array<f32, STEPS + 1>>, stride: i32) -> f32 {
    var worst = 0.0;
    for (var i = 0; i < STEPS; i += 1) {
        let start = i & -stride;
        let way = f32(i - start) / f32(stride);
        worst = max(worst, abs((*line)[i] - mix((*line)[start], (*line)[start + stride], way)));
    }
    return worst;
}

// Metres that the lines to the neighbours are off with edges halved 0, 1 and 2 times.
fn errors_around(corner: vec2<u32>, first: vec2<u32>, last: vec2<u32>) -> vec3<f32> {
    let middle = lattice_point(corner);
    var errors = vec3<f32>(0.0);
    for (var y = first.y; y <= last.y; y += 1u) {
        for (var x = first.x; x <= last.x; x += 1u) {
            let along = lattice_point(vec2<u32>(x, y)) - middle;
            var line: array<f32, STEPS + 1>;
            for (var i = 0; i <= STEPS; i += 1) {
                // the remainder apart, for the sake of whole numbers in wide cells
                let step = (along / STEPS) * i + ((along % STEPS) * i) / STEPS;
                line[i] = height_at(Point(middle + step, vec2<f32>(0.0)));
            }
            errors = max(errors, vec3<f32>(off_chords(&line, 8), off_chords(&line, 4), off_chords(&line, 2)));
        }
    }
    return errors * frame.exaggeration;
}

// Smooth ground: each time that edges are halved errors fall to a quarter.
fn extrapolated(error: f32, allowed: f32) -> f32 { return 2.0 + 0.5 * log2(max(error, 1e-30) / allowed); }

fn depth_for(errors: vec3<f32>, allowed: f32) -> f32 {
    if (TAG == 1) { return extrapolated(errors.z, allowed); }
    if (errors.x <= allowed) { return 0.0; }
    if (errors.y <= allowed) { return 1.0; }
    return max(extrapolated(errors.z, allowed), 2.0);
}

@compute @workgroup_size(64)
fn tag_vertices(@builtin(global_invocation_id) id: vec3<u32>) {
    let corner = corner_of(id.x);
    if (corner.y > gamer.cells.y) { return; }
    let first = max(corner, vec2<u32>(1u)) - 1u;
    let last = min(corner + 1u, gamer.cells);
    // metres that `pixels` cover at that distance (Houska 2019, equation 2.3)
    let allowed = gamer.pixels * max(distance_around(first, last), 1e-3) / frame.lod_pixels_per_radian;
    var tag = 0.0;
    if (TAG == 0) {
        tag = log2(gamer.width / allowed);
    } else {
        tag = depth_for(errors_around(corner, first, last), allowed);
    }
    vertices[id.x].tag = clamp(tag, 0.0, MOST);
}
