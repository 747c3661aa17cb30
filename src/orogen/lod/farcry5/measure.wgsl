#include place.wgsl
#include box.wgsl
// The box around a patch's triangles as they are drawn, and whether any of them faces the eye: one workgroup a patch.

struct State {
    level: u32,
    parents: u32,
    children: u32,
    nodes: u32,
    patches: u32,
    visible: u32,
    hidden: u32,
    revealed: u32,
    undersides: atomic<u32>,   // 1: the eye is below ground, or the near plane may cut into it
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> patches: array<PatchTile>;
@group(1) @binding(3) var<storage, read_write> boxes: array<Box>;

const SIDE = QUADS + 1u;
const THREADS = 64u;
const THINNEST = 1.0 / 64.0;

var<workgroup> east: array<f32, SIDE * SIDE>;
var<workgroup> north: array<f32, SIDE * SIDE>;
var<workgroup> up: array<f32, SIDE * SIDE>;
var<workgroup> lows: array<vec3<f32>, THREADS>;
var<workgroup> highs: array<vec3<f32>, THREADS>;
var<workgroup> front: atomic<u32>;

fn vertex_at(i: u32) -> vec3<f32> { return vec3<f32>(east[i], north[i], up[i]); }

// Whether the eye is surely below the plane of a triangle. One that is seen so nearly edge on that it is thinner than
// THINNEST pixels may turn over where a rasteriser rounds its corners.
fn shows_underside(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> bool {
    let m = frame.metres;
    let upwards = cross(b - a, c - a) * sign(m.x * m.w - m.y * m.z);
    let to_eye = frame.lod_eye - a;
    let longest = max(distance(a, b), max(distance(b, c), distance(c, a)));
    let thinnest = max(THINNEST / frame.lod_pixels_per_radian, 1e-6);
    return dot(upwards, to_eye) < -thinnest * longest * dot(to_eye, to_eye);
}

fn is_point(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> bool {
    return all(a == b) || all(b == c) || all(c == a);
}

// Notes whether the eye sees a triangle's upper side, and whether undersides may be seen because of it.
fn look_at(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) {
    if (is_point(a, b, c)) { return; }
    let low = min(a, min(b, c));
    let high = max(a, max(b, c));
    let away = max(max(low - frame.lod_eye, frame.lod_eye - high), vec3<f32>(0.0));
    let under = shows_underside(a, b, c);
    if (!under) { atomicOr(&front, 1u); }
    if (length(away) <= farcry.near_reach || (under && all(away.xy == vec2<f32>(0.0)))) {
        atomicOr(&state.undersides, 1u);
    }
}

@compute @workgroup_size(THREADS)
fn measure_patches(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    // spare workgroups of the last row repeat the last patch
    let index = min(group.y * ROW + group.x, min(state.patches, farcry.capacity) - 1u);
    let tile = patches[index];
    var low = vec3<f32>(1e30);
    var high = vec3<f32>(-1e30);
    for (var i = local; i < SIDE * SIDE; i += THREADS) {
        let p = vertex_point(tile, vec2<u32>(i % SIDE, i / SIDE));
        let position = lift(flat_position(p), height_at(p));
        east[i] = position.x;
        north[i] = position.y;
        up[i] = position.z;
        low = min(low, position);
        high = max(high, position);
    }
    // not all drivers clear it
    if (local == 0u) { atomicStore(&front, 0u); }
    lows[local] = low;
    highs[local] = high;
    workgroupBarrier();
    for (var i = local; i < QUADS * QUADS; i += THREADS) {
        let first = i / QUADS * SIDE + i % QUADS;
        look_at(vertex_at(first), vertex_at(first + 1u), vertex_at(first + SIDE));
        look_at(vertex_at(first + 1u), vertex_at(first + SIDE + 1u), vertex_at(first + SIDE));
    }
    workgroupBarrier();
    if (local > 0u) { return; }
    for (var i = 1u; i < THREADS; i += 1u) {
        low = min(low, lows[i]);
        high = max(high, highs[i]);
    }
    boxes[index] = Box(low, atomicLoad(&front), high);
}
