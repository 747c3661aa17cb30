#include tiles.wgsl
#include frustum.wgsl
// Tile refinement (Kuehnert 2022, algorithm 1): a dispatch per level over a list that is used from both ends in turn,
// parents on one side and children on the other. The last workgroup of a level sets up the next; the first levels, which
// have no more tiles than a workgroup has invocations, are one dispatch.

const GROUP = 256u;
const TOP_LEVELS = 5;        // 4^4 tiles fit one workgroup
const DONE_BITS = 12u;

struct State {
    parents: u32,
    progress: atomic<u32>,   // workgroups that are done with the level; from DONE_BITS on tiles that were divided
    finals: atomic<u32>,
    backwards: u32,          // 1: the parents are at the end of the list
    overflow: atomic<u32>,   // how many tiles could not be divided for want of room
    tiles: atomic<u32>,      // final ones and those still to be looked at: never more than the capacity
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(2) var<storage, read_write> temporary_tiles: array<Tile>;
@group(1) @binding(3) var<storage, read_write> final_tiles: array<FinalTile>;
@group(2) @binding(0) var<storage, read_write> next_groups: array<u32, 3>;   // arguments of the next dispatch

var<workgroup> group_divided: atomic<u32>;
var<workgroup> group_ended: atomic<u32>;
var<workgroup> first_child: u32;
var<workgroup> first_final: u32;

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

fn nearest_on_edge(p: vec2<f32>, a: vec2<f32>, b: vec2<f32>) -> f32 {
    let along = b - a;
    let way = clamp(dot(p - a, along) / max(dot(along, along), 1e-30), 0.0, 1.0);
    return lod_distance(a + way * along);
}

// Distance of the LOD eye to the nearest point of a rectangle of subtexels, which need not be one in metres.
fn nearest_distance(low: vec2<i32>, high: vec2<i32>) -> f32 {
    let l = vec2<f32>(low - frame.anchor) - frame.eye_offset;
    let h = vec2<f32>(high - frame.anchor) - frame.eye_offset;
    let eye = to_subtexels(frame.lod_eye.xy);
    if (all(eye >= l) && all(eye <= h)) { return lod_distance(frame.lod_eye.xy); }
    let a = to_metres(l);
    let b = to_metres(vec2<f32>(h.x, l.y));
    let c = to_metres(h);
    let d = to_metres(vec2<f32>(l.x, h.y));
    let p = frame.lod_eye.xy;
    return min(min(nearest_on_edge(p, a, b), nearest_on_edge(p, b, c)),
               min(nearest_on_edge(p, c, d), nearest_on_edge(p, d, a)));
}

fn should_be_divided(tile: Tile, low: vec2<i32>, high: vec2<i32>) -> bool {
    if (tile.level == 0u) { return false; }
    // a little early: where rounding makes a vertex on the border of an undivided tile nearer than the tile, it still
    // has to be fully morphed
    return nearest_distance(low, high) < range_end(tile.level - 1u) * 1.00001;
}

fn is_visible(tile: Tile, low: vec2<i32>, high: vec2<i32>) -> bool {
    if (any(low >= frame.extent.zw)) { return false; }
    // before the first data has come there is nothing to draw
    if (clipmap.layers[HEIGHTS].present == 0u) { return false; }
    return !rectangle_outside(low, high);
}

// The one node that all heights of a tile come from, or MANY_NODES.
fn node_of(low: vec2<i32>, high: vec2<i32>) -> u32 {
    let l = vec2<f32>(low - frame.anchor) - frame.eye_offset;
    let h = vec2<f32>(high - frame.anchor) - frame.eye_offset;
    let far = max(max(lod_distance(to_metres(l)), lod_distance(to_metres(h))),
                  max(lod_distance(to_metres(vec2<f32>(h.x, l.y))), lod_distance(to_metres(vec2<f32>(l.x, h.y)))));
    // from one level alone: not blended, with room for rounding
    let level = distance_level(HEIGHTS, nearest_distance(low, high) * 0.9999);
    let whole = floor(level);
    if (distance_level(HEIGHTS, far * 1.0001) - whole > 0.9999 - clipmap.layers[HEIGHTS].blend_range) { return MANY_NODES; }
    let a = lookup(HEIGHTS, low, u32(whole));
    let b = lookup(HEIGHTS, high, u32(whole));
    // windows are rectangles: what holds two corners holds the tile
    let shift = vec2<u32>(frame.subtexel_bits + NODE_BITS + u32(whole));
    let same = a.asked == u32(whole) && b.asked == u32(whole) && all((low >> shift) == (high >> shift));
    return select(MANY_NODES, a.slot | (a.level << 16u), same);
}

// One tile for each invocation of a workgroup.
fn refine_tile(i: u32, local: u32) {
    if (local == 0u) {
        atomicStore(&group_divided, 0u);
        atomicStore(&group_ended, 0u);
    }
    workgroupBarrier();
    let parents = state.parents;
    let backwards = state.backwards == 1u;
    var tile = Tile();
    var low = vec2<i32>();
    var high = vec2<i32>();
    var divided = false;
    var ended = false;
    var place = 0u;
    if (i < parents) {
        tile = temporary_tiles[list_index(i, backwards)];
        low = tile_corner(tile);
        high = min(low + quad_size(tile.level) * i32(tiling.grid_size), frame.extent.zw);
        if (is_visible(tile, low, high)) {
            // without room a tile stays coarse, which is better than a hole, until the list has grown
            divided = should_be_divided(tile, low, high) && reserve();
            ended = !divided;
        } else {
            atomicSub(&state.tiles, 1u);
        }
        if (divided) { place = atomicAdd(&group_divided, 1u); }
        if (ended) { place = atomicAdd(&group_ended, 1u); }
    }
    workgroupBarrier();
    if (local == 0u) {
        first_final = atomicAdd(&state.finals, atomicLoad(&group_ended));
        let before = atomicAdd(&state.progress, (atomicLoad(&group_divided) << DONE_BITS) + 1u);
        first_child = before >> DONE_BITS;
        // the level is done when its last workgroup is: the others have read what is overwritten here
        if ((before & ((1u << DONE_BITS) - 1u)) + 1u == max((parents + GROUP - 1u) / GROUP, 1u)) {
            state.parents = 4u * (first_child + atomicLoad(&group_divided));
            state.backwards = select(1u, 0u, backwards);
            atomicStore(&state.progress, 0u);
            next_groups = array<u32, 3>((state.parents + GROUP - 1u) / GROUP, 1u, 1u);
        }
    }
    workgroupBarrier();
    if (ended) { final_tiles[first_final + place] = FinalTile(tile.x, tile.y, tile.level, node_of(low, high)); }
    if (divided) {
        for (var n = 0u; n < 4u; n += 1u) {
            let child = Tile(2u * tile.x + (n & 1u), 2u * tile.y + (n >> 1u), tile.level - 1u);
            temporary_tiles[list_index(4u * (first_child + place) + n, !backwards)] = child;
        }
    }
}

@compute @workgroup_size(GROUP)
fn refine_top(@builtin(local_invocation_index) local: u32) {
    if (local == 0u) {
        temporary_tiles[0] = Tile(0u, 0u, tiling.root_level);
        state.parents = 1u;
        state.backwards = 0u;
        atomicStore(&state.progress, 0u);
        atomicStore(&state.finals, 0u);
        atomicStore(&state.overflow, 0u);
        atomicStore(&state.tiles, 1u);
    }
    for (var level = 0; level < TOP_LEVELS; level += 1) {
        storageBarrier();
        refine_tile(local, local);
    }
}

@compute @workgroup_size(GROUP)
fn refine_tiles(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    refine_tile(id.x, local);
}
