#include lod/tiles.wgsl
#include lod/tile_box.wgsl
#include lod/depth_pyramid.wgsl
// Tile refinement (Kuehnert 2022, algorithm 1): a dispatch per level over a list that is used from both ends in turn,
// parents on one side and children on the other. The last workgroup of a level sets up the next; the first levels, which
// have no more tiles than a workgroup has invocations, are one dispatch.
//
// Tiles that the frame before would hide are put aside as they are. When the others have been drawn, those among them that
// these do not hide are refined in a few levels more.

const GROUP = #{GROUP}u;      // small, so that also levels of few tiles reach all of the GPU
const TOP_GROUP = 256u;
const TOP_LEVELS = 5;        // 4^4 tiles fit one workgroup
const DONE_BITS = 14u;
const REFINE = 0u;
const REVEAL_FIRST = 1u;     // of those put aside
const REVEAL = 2u;           // of what became of them
const SIFT = #{SIFT};        // find final tiles of whose triangles nothing is seen by their samples
const MOST_DIVISIONS = #{MOST_DIVISIONS}u;   // of a tile that is put aside

// Arguments of an indexed draw, whose instances are final tiles.
struct Draw { indices: u32, tiles: atomic<u32>, first_index: u32, base_vertex: u32, first_instance: u32 }

struct State {
    draws: array<Draw, 2>,   // of the final tiles, and of those among the ones put aside
    parents: u32,
    progress: atomic<u32>,   // workgroups that are done with the level; from DONE_BITS on tiles that were divided
    backwards: u32,          // 1: the parents are at the end of the list
    overflow: atomic<u32>,   // how many tiles could not be divided for want of room
    tiles: atomic<u32>,      // final ones and those still to be looked at: never more than the capacity
    hidden: atomic<u32>,     // put aside
    spared: atomic<u32>,     // about how many more tiles inside the frustum would have been drawn if none were put aside
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> temporary_tiles: array<Tile>;
@group(1) @binding(3) var<storage, read_write> final_tiles: array<FinalTile>;
@group(1) @binding(5) var<storage, read_write> hidden_tiles: array<Tile>;
@group(2) @binding(0) var<storage, read_write> next_groups: array<u32, 3>;   // arguments of the next dispatch

var<workgroup> group_divided: atomic<u32>;
var<workgroup> group_ended: atomic<u32>;
var<workgroup> group_hidden: atomic<u32>;
var<workgroup> first_child: u32;
var<workgroup> first_final: u32;
var<workgroup> first_hidden: u32;

// The list has room for twice the capacity: for the parents and for their children.
fn list_index(i: u32, backwards: bool) -> u32 {
    return select(i, 2u * tiling.tile_capacity - 1u - i, backwards);
}

// Make one tile four, if there is room.
fn reserve() -> bool {
    if (atomicAdd(&state.tiles, 3u) + 3u <= tiling.tile_capacity) { return true; }
    atomicSub(&state.tiles, 3u);
    atomicAdd(&state.overflow, 1u);
    return false;
}

// Whether a tile is divided so many times at least in places, all of it being at least as far as `nearest`.
fn should_be_divided(tile: Tile, nearest: f32, times: u32) -> bool {
    if (tile.level < times) { return false; }
    // a little early: where rounding makes a vertex on the border of an undivided tile nearer than the tile, it still
    // has to be fully morphed
    return nearest < range_end(tile.level - times) * 1.00001;
}

// How many tiles a hidden one would have become, all of it being as far as its nearest point.
fn tiles_within(tile: Tile, nearest: f32) -> u32 {
    var times = 0u;
    while (times < MOST_DIVISIONS && should_be_divided(tile, nearest, times + 1u)) { times += 1u; }
    return 1u << (2u * times);
}

// Triangles that morph are two quads wide.
fn tile_parts() -> f32 { return 0.5 * f32(tiling.grid_size); }

// Whether a tile is not seen for what the frame before drew, and can wait until that is sure. Where nothing is known of
// that frame, all but the foreground waits.
fn should_be_put_aside(tile: Tile, nearest: f32, box: Box) -> bool {
    if (should_be_divided(tile, nearest * 0.9999, MOST_DIVISIONS + 1u)) { return false; }
    if (tiling.history == 0u) { return nearest > tiling.foreground; }
    return is_hidden(box.low, box.high, tile_parts(), tiling.to_history);
}

fn tests_depth(phase: u32) -> bool { return phase != REFINE || tiling.history == 1u; }

fn is_hidden_now(box: Box) -> bool { return is_hidden(box.low, box.high, tile_parts(), frame.view_projection); }

fn may_be_visible(tile: Tile, low: vec2<i32>, high: vec2<i32>) -> bool {
    if (any(low >= frame.extent.zw)) { return false; }
    // before the first data has come there is nothing to draw
    if (clipmap.layers[HEIGHTS].present == 0u) { return false; }
    return !rectangle_outside(low, high);
}

// The one node that all heights of a tile come from, or MANY_NODES.
fn node_of(low: vec2<i32>, high: vec2<i32>, reach: Reach) -> u32 {
    let levels = levels_over(reach);
    if (levels.x != levels.y) { return MANY_NODES; }
    let a = lookup(HEIGHTS, low, levels.x);
    let b = lookup(HEIGHTS, high, levels.x);
    // windows are rectangles: what holds two corners holds the tile
    let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + levels.x);
    let same = a.asked == levels.x && b.asked == levels.x && all((low >> shift) == (high >> shift));
    return select(MANY_NODES, a.slot | (a.level << 16u), same);
}

// One tile for each of the `group` invocations of a workgroup: of the list, or of those put aside.
fn refine_tile(i: u32, local: u32, phase: u32, group: u32) {
    if (local == 0u) {
        atomicStore(&group_divided, 0u);
        atomicStore(&group_ended, 0u);
        atomicStore(&group_hidden, 0u);
    }
    workgroupBarrier();
    let parents = state.parents;
    let backwards = state.backwards == 1u;
    var tile = Tile();
    var low = vec2<i32>();
    var high = vec2<i32>();
    var reach = Reach();
    var divided = false;
    var ended = false;
    var hidden = false;
    var place = 0u;
    if (i < parents) {
        if (phase == REVEAL_FIRST) {
            tile = hidden_tiles[i];
        } else {
            tile = temporary_tiles[list_index(i, backwards)];
        }
        low = tile_corner(tile);
        high = min(low + quad_size(tile.level) * i32(tiling.grid_size), frame.extent.zw);
        var gone = !may_be_visible(tile, low, high);
        var box = Box();
        var inside = true;
        if (!gone) {
            reach = reach_of(low, high);
            if (SIFT || tests_depth(phase)) {
                let bounds = bounds_around(low, high);
                box = box_between(low, high, bounds);
                inside = box_inside(box);
                if (!inside || tests_depth(phase)) { box = box_between(low, high, bounds_below(low, high, reach, bounds)); }
                gone = box_outside(box);
            }
            if (!gone && phase == REFINE) { hidden = should_be_put_aside(tile, reach.nearest, box); }
            if (!gone && phase != REFINE && is_hidden_now(box)) {
                gone = true;
                if (box_inside(box)) { atomicAdd(&group_hidden, tiles_within(tile, reach.nearest)); }
            }
        }
        if (!gone && !hidden) {
            // without room a tile stays coarse, which is better than a hole, until the list has grown
            divided = should_be_divided(tile, reach.nearest, 1u) && reserve();
            gone = SIFT && !divided && !(inside && COVERED) && is_empty(low, high, reach, box);
            ended = !divided && !gone;
        }
        if (gone) { atomicSub(&state.tiles, 1u); }
        if (divided) { place = atomicAdd(&group_divided, 1u); }
        if (ended) { place = atomicAdd(&group_ended, 1u); }
        if (hidden) { place = atomicAdd(&group_hidden, 1u); }
    }
    workgroupBarrier();
    if (local == 0u) {
        first_final = atomicAdd(&state.draws[select(1u, 0u, phase == REFINE)].tiles, atomicLoad(&group_ended));
        if (phase == REFINE) {
            first_hidden = atomicAdd(&state.hidden, atomicLoad(&group_hidden));
        } else {
            atomicAdd(&state.spared, atomicLoad(&group_hidden));
        }
        let before = atomicAdd(&state.progress, (atomicLoad(&group_divided) << DONE_BITS) + 1u);
        first_child = before >> DONE_BITS;
        // the level is done when its last workgroup is: the others have read what is overwritten here
        if ((before & ((1u << DONE_BITS) - 1u)) + 1u == max((parents + group - 1u) / group, 1u)) {
            state.parents = 4u * (first_child + atomicLoad(&group_divided));
            state.backwards = select(1u, 0u, backwards);
            atomicStore(&state.progress, 0u);
            next_groups = array<u32, 3>((state.parents + GROUP - 1u) / GROUP, 1u, 1u);
        }
    }
    workgroupBarrier();
    if (ended) { final_tiles[first_final + place] = FinalTile(tile.x, tile.y, tile.level, node_of(low, high, reach)); }
    if (hidden) { hidden_tiles[first_hidden + place] = tile; }
    if (divided) {
        for (var n = 0u; n < 4u; n += 1u) {
            let child = Tile(2u * tile.x + (n & 1u), 2u * tile.y + (n >> 1u), tile.level - 1u);
            temporary_tiles[list_index(4u * (first_child + place) + n, !backwards)] = child;
        }
    }
}

@compute @workgroup_size(TOP_GROUP)
fn refine_top(@builtin(local_invocation_index) local: u32) {
    if (local == 0u) {
        temporary_tiles[0] = Tile(0u, 0u, tiling.root_level);
        for (var i = 0u; i < 2u; i += 1u) {
            state.draws[i].indices = 6u * tiling.grid_size * tiling.grid_size;
            atomicStore(&state.draws[i].tiles, 0u);
        }
        state.parents = 1u;
        state.backwards = 0u;
        atomicStore(&state.progress, 0u);
        atomicStore(&state.overflow, 0u);
        atomicStore(&state.tiles, 1u);
        atomicStore(&state.hidden, 0u);
        atomicStore(&state.spared, 0u);
    }
    for (var level = 0; level < TOP_LEVELS; level += 1) {
        storageBarrier();
        refine_tile(local, local, REFINE, TOP_GROUP);
    }
}

@compute @workgroup_size(GROUP)
fn refine_tiles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    refine_tile(id.x, local, REFINE, GROUP);
}

// Those put aside become the list.
@compute @workgroup_size(1)
fn start_reveal() {
    state.parents = atomicLoad(&state.hidden);
    state.backwards = 0u;
    next_groups = array<u32, 3>((state.parents + GROUP - 1u) / GROUP, 1u, 1u);
}

@compute @workgroup_size(GROUP)
fn reveal_hidden(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    refine_tile(id.x, local, REVEAL_FIRST, GROUP);
}

@compute @workgroup_size(GROUP)
fn reveal_tiles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    refine_tile(id.x, local, REVEAL, GROUP);
}
