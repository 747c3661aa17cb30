#include lod/tiles.wgsl
#include counts.wgsl
#include blocks.wgsl
// Triangles or rays: what a tile costs either way (Dick, Krueger and Westermann 2010), as the LOD camera sees it.

const GROUP = 64u;

struct Choice {
    view_projection: mat4x4<f32>,   // of the LOD camera, from camera-relative metres
    half: vec2<f32>,                // half the picture in pixels, x mirrored where columns and rows turn against east and north
    cost_triangle: f32,
    cost_step: f32,
}

struct Tally { tiles: u32, triangles: atomic<u32>, rays: atomic<u32>, steps: atomic<u32> }

@group(1) @binding(1) var<uniform> choice: Choice;
@group(1) @binding(2) var<storage, read> final_tiles: array<FinalTile>;
@group(1) @binding(3) var<storage, read_write> chosen_tiles: array<FinalTile>;    // triangles from the start, rays from the end
@group(1) @binding(4) var<storage, read_write> tally: Tally;

var<workgroup> group_triangles: atomic<u32>;
var<workgroup> group_rays: atomic<u32>;
var<workgroup> group_steps: atomic<u32>;
var<workgroup> first_triangles: u32;
var<workgroup> first_rays: u32;

// Pixels from the picture's centre, in which what faces the eye turns from columns to rows; what lies outside the picture
// or behind the eye is moved to the picture's border.
fn on_screen(position: vec3<f32>) -> vec2<f32> {
    let clip = choice.view_projection * vec4<f32>(position, 1.0);
    return clamp(clip.xy / max(clip.w, 1e-6), vec2<f32>(-1.0), vec2<f32>(1.0)) * choice.half;
}

// Pixels in which rays are cast for a tile, and steps of the traversal that one takes in it.
struct Load { pixels: f32, steps: f32 }

fn load_of(tile: FinalTile) -> Load {
    let low = tile_corner(Tile(tile.x, tile.y, tile.level));
    let half = quad_size(tile.level) * i32(tiling.grid_size / 2u);
    // 3 x 3 points of the tile, row by row
    var seen: array<vec2<f32>, 9>;
    var heights = vec2<f32>(1e30, -1e30);
    for (var i = 0; i < 9; i += 1) {
        let p = clamp_to_extent(Point(low + vec2<i32>(i % 3, i / 3) * half, vec2<f32>(0.0)));
        let height = tile_height(p, tile.node);
        heights = vec2<f32>(min(heights.x, height), max(heights.y, height));
        seen[i] = on_screen(lift(flat_position(p), height));
    }
    var pixels = 0.0;
    for (var i = 0; i < 4; i += 1) {
        let first = i + i / 2;
        let across = seen[first + 4] - seen[first];
        let down = seen[first + 3] - seen[first + 1];
        pixels += max(0.5 * (across.x * down.y - across.y * down.x), 0.0);
    }
    let high = min(low + 2 * half, frame.extent.zw);
    let a = flat_position(Point(low, vec2<f32>(0.0)));
    let b = flat_position(Point(high, vec2<f32>(0.0)));
    let middle = clamp_to_extent(Point(low + half, vec2<f32>(0.0)));
    let level = resident_level(middle, u32(lod_at(middle)));
    let cells = max(f32(2 * half) * inverse_power(frame.subtexel_bits + level), 1.0);
    // a ray goes down the maximum pyramid, and the more often the less it falls over ground that rises and falls itself
    let toward = lift(flat_position(middle), 0.5 * (heights.x + heights.y)) - frame.lod_eye;
    let fall = 0.7071068 * distance(a, b) * abs(toward.z) / max(length(toward.xy), 1e-6);
    let relief = (heights.y - heights.x) * frame.exaggeration;
    // rays are cast in whole blocks of pixels
    let side = sqrt(pixels) + f32(1u << BLOCK_BITS);
    return Load(side * side, 2.0 + log2(cells) + log2(1.0 + relief / max(fall, 1e-6)));
}

@compute @workgroup_size(GROUP)
fn choose_tiles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    if (local == 0u) {
        atomicStore(&group_triangles, 0u);
        atomicStore(&group_rays, 0u);
        atomicStore(&group_steps, 0u);
    }
    workgroupBarrier();
    let here = id.x < tally.tiles;
    var tile = FinalTile();
    var by_rays = false;
    var place = 0u;
    if (here) {
        tile = final_tiles[id.x];
        let load = load_of(tile);
        let steps = load.pixels * load.steps;
        by_rays = steps * choice.cost_step < f32(2u * tiling.grid_size * tiling.grid_size) * choice.cost_triangle;
        if (by_rays) {
            place = atomicAdd(&group_rays, 1u);
            atomicAdd(&group_steps, u32(steps / STEP_UNIT));
        } else {
            place = atomicAdd(&group_triangles, 1u);
        }
    }
    workgroupBarrier();
    if (local == 0u) {
        first_triangles = atomicAdd(&tally.triangles, atomicLoad(&group_triangles));
        first_rays = atomicAdd(&tally.rays, atomicLoad(&group_rays));
        atomicAdd(&tally.steps, atomicLoad(&group_steps));
    }
    workgroupBarrier();
    if (here) {
        chosen_tiles[select(first_triangles + place, tiling.tile_capacity - 1u - first_rays - place, by_rays)] = tile;
    }
}
