// Sun ceilings of the node atlas: per block of BLOCK x BLOCK cells the height over which a ray towards the sun that is above
// the surface there leaves the node without meeting it. Where every bilinear cell falls away from such rays they can only
// rise over it, so that cells which somewhere rise towards the sun faster than the rays are the only obstacles.
//
// Heights are sheared along the rays, so that a ray's is the same everywhere: less the rise from the node's corner.

#include heightformat.wgsl

const HEIGHT_BORDER = #{HEIGHT_BORDER};
const NODE_SIZE = 1i << #{NODE_BITS}u;
const BLOCK = #{CEILING_BLOCK};
const SIDE = NODE_SIZE / BLOCK + 1;
const NOTHING = -1e30;

struct Sun {
    way: vec2<f32>,      // towards the sun, texels of level 0 (columns, rows) per metre of the ray
    slope: vec2<f32>,    // what rays rise, metres of the data per such texel
    rise: f32,           // metres of the data per metre of the ray
    step: i32,           // how far the blocks are apart that `spread` joins; 0: neighbours
    last: u32,           // 1: the target is the atlas
}

@group(0) @binding(0) var<storage, read> slots: array<u32>;      // slot | level << 16
@group(0) @binding(1) var height_atlas: texture_2d_array<HeightTexel>;
@group(0) @binding(2) var source: texture_2d_array<f32>;
@group(0) @binding(3) var destination: texture_storage_2d_array<r32float, write>;
@group(0) @binding(4) var<uniform> sun: Sun;

fn corner_height(slot: i32, at: vec2<i32>, slope: vec2<f32>) -> vec2<f32> {
    let height = height_of(textureLoad(height_atlas, at + HEIGHT_BORDER, slot, 0).x);
    return vec2<f32>(height, height - dot(slope, vec2<f32>(at + 1)));
}

// The highest corner of each block's obstacles.
@compute @workgroup_size(8, 8)
fn obstacles(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(vec2<i32>(id.xy) >= vec2<i32>(SIDE))) { return; }
    let slot = i32(slots[id.z] & 0xffffu);
    let scale = f32(1u << (slots[id.z] >> 16u));
    let way = sun.way / scale;
    let slope = sun.slope * scale;
    let first = vec2<i32>(id.xy) * BLOCK;
    let stop = min(first + BLOCK, vec2<i32>(NODE_SIZE + 1));
    var highest = NOTHING;
    for (var y = first.y; y < stop.y; y += 1) {
        var a = corner_height(slot, vec2<i32>(first.x - 1, y - 1), slope);
        var c = corner_height(slot, vec2<i32>(first.x - 1, y), slope);
        for (var x = first.x; x < stop.x; x += 1) {
            let b = corner_height(slot, vec2<i32>(x, y - 1), slope);
            let d = corner_height(slot, vec2<i32>(x, y), slope);
            // bilinear: the steepest rise is at a corner
            let rise = max((b.x - a.x) * way.x, (d.x - c.x) * way.x) + max((c.x - a.x) * way.y, (d.x - b.x) * way.y);
            if (!(rise < sun.rise)) { highest = max(highest, max(max(a.y, b.y), max(c.y, d.y))); }
            a = b;
            c = d;
        }
    }
    textureStore(destination, id.xy, i32(id.z), vec4<f32>(highest));
}

// Joins what rays from a block meet within `step` blocks to what they meet within as many behind that.
@compute @workgroup_size(8, 8)
fn spread(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(vec2<i32>(id.xy) >= vec2<i32>(SIDE))) { return; }
    let here = vec2<i32>(id.xy);
    let offset = sun.way / max(abs(sun.way.x), abs(sun.way.y)) * f32(sun.step);
    let near = sign(sun.way);
    let low = here + select(vec2<i32>(floor(offset)), vec2<i32>(min(near, vec2<f32>(0.0))), sun.step == 0);
    let high = here + select(vec2<i32>(ceil(offset)), vec2<i32>(max(near, vec2<f32>(0.0))), sun.step == 0);
    var highest = textureLoad(source, here, i32(id.z), 0).x;
    for (var y = max(low.y, 0); y <= min(high.y, SIDE - 1); y += 1) {
        for (var x = max(low.x, 0); x <= min(high.x, SIDE - 1); x += 1) {
            highest = max(highest, textureLoad(source, vec2<i32>(x, y), i32(id.z), 0).x);
        }
    }
    let layer = select(id.z, slots[id.z] & 0xffffu, sun.last != 0u);
    textureStore(destination, here, i32(layer), vec4<f32>(highest));
}
