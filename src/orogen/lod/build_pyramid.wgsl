#include lod/depth_cells.wgsl
// The depth pyramid, one dispatch a level: reverse z, so that the farthest depth is the least; the sky's is 0.

struct Level { level: u32 }

@group(1) @binding(0) var<uniform> to_build: Level;
@group(1) @binding(1) var surface_depths: texture_2d<f32>;
@group(1) @binding(2) var<storage, read_write> depth_cells: array<f32>;

fn write_cell(cell: vec2<u32>, depth: f32) {
    depth_cells[first_cell(to_build.level) + cell.y * cells_of(to_build.level).x + cell.x] = depth;
}

@compute @workgroup_size(8, 8)
fn reduce_surface(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= cells_of(1u))) { return; }
    let end = min(4u * id.xy + 4u, frame.size);
    var farthest = 1.0;
    for (var y = 4u * id.y; y < end.y; y += 1u) {
        for (var x = 4u * id.x; x < end.x; x += 1u) {
            farthest = min(farthest, textureLoad(surface_depths, vec2<u32>(x, y), 0).x);
        }
    }
    write_cell(id.xy, farthest);
}

@compute @workgroup_size(8, 8)
fn reduce_cells(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= cells_of(to_build.level))) { return; }
    let below = cells_of(to_build.level - 1u);
    let start = first_cell(to_build.level - 1u);
    let end = min(4u * id.xy + 4u, below);
    var farthest = 1.0;
    for (var y = 4u * id.y; y < end.y; y += 1u) {
        for (var x = 4u * id.x; x < end.x; x += 1u) {
            farthest = min(farthest, depth_cells[start + y * below.x + x]);
        }
    }
    write_cell(id.xy, farthest);
}
