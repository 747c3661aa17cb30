// Maximum pyramids of the node atlas (Houska 2019, section 2.3.7): entry b of level k is the greatest of the
// (2^k + 1)^2 samples that the cells [b 2^k, (b + 1) 2^k) touch. Maxima of the samples alone would miss the far edge.

const HEIGHT_BORDER = #{HEIGHT_BORDER};

#include heightformat.wgsl
#include maxima_layout.wgsl

@group(0) @binding(0) var<storage, read> slots: array<u32>;
@group(0) @binding(1) var height_atlas: texture_2d_array<HeightTexel>;
@group(0) @binding(2) var maxima_atlas: texture_storage_2d_array<r32float, read_write>;
@group(0) @binding(3) var<uniform> level: u32;

@compute @workgroup_size(8, 8)
fn build(@builtin(global_invocation_id) id: vec3<u32>) {
    let side = (NODE_SIZE >> level) + 1u;
    if (any(id.xy >= vec2<u32>(side))) { return; }
    let slot = i32(slots[id.z]);
    let b = vec2<i32>(id.xy);
    var highest = -1e30;
    if (level == 1u) {
        for (var y = -1; y <= 1; y += 1) {
            for (var x = -1; x <= 1; x += 1) {
                // the last block has one cell in the node: its far samples lie in the border
                let sample = 2 * b + vec2<i32>(x, y) + HEIGHT_BORDER;
                highest = max(highest, height_of(textureLoad(height_atlas, sample, slot, 0).x));
            }
        }
    } else {
        let last = vec2<i32>(i32(NODE_SIZE >> (level - 1u)));
        for (var y = 0; y <= 1; y += 1) {
            for (var x = 0; x <= 1; x += 1) {
                let child = min(2 * b + vec2<i32>(x, y), last);
                highest = max(highest, textureLoad(maxima_atlas, maxima_place(level - 1u, child), slot).x);
            }
        }
    }
    textureStore(maxima_atlas, maxima_place(level, b), slot, vec4<f32>(highest));
}
