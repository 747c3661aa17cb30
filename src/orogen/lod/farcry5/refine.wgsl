#include lod_map.wgsl
#include prism.wgsl
// The node list: one dispatch a level, from the root down. A node gives way to its four children, or is drawn and entered
// in the LOD map. Nothing is culled here: seams and shadows need the nodes beside the picture, too.

struct State {
    level: u32,
    parents: u32,
    children: atomic<u32>,
    nodes: atomic<u32>,
}

@group(1) @binding(1) var<storage, read_write> state: State;
@group(1) @binding(3) var<storage, read_write> temporary_nodes: array<vec2<u32>>;   // parents and children, in turn
@group(1) @binding(4) var<storage, read_write> nodes: array<NodeTile>;

fn temporary_index(i: u32, level: u32) -> u32 { return ((level & 1u) << (2u * farcry.map_bits)) + i; }

fn is_outside(node: NodeTile) -> bool { return any(node_corner(node) >= frame.extent.zw); }

// Whether the data is loaded as fine as the node; what is finer than the data needs its finest level.
fn is_resident(node: NodeTile) -> bool {
    let size = firstLeadingBit(farcry.leaf) + NODE_QUADS_BITS + node.level;
    let level = u32(max(0, i32(size) - i32(frame.subtexel_bits + NODE_BITS)));
    return lookup(HEIGHTS, node_corner(node), level).level <= level;
}

fn child_of(node: NodeTile, i: u32) -> NodeTile {
    return NodeTile(2u * node.x + (i & 1u), 2u * node.y + (i >> 1u), node.level - 1u);
}

fn children_can_be_drawn(node: NodeTile) -> bool {
    for (var i = 0u; i < 4u; i += 1u) {
        let child = child_of(node, i);
        if (is_outside(child)) { continue; }
        if (!is_resident(child) || !in_window(vec2<i32>(vec2<u32>(child.x, child.y)), child.level)) { return false; }
    }
    return true;
}

// Vertices of a child could not follow the edge of a neighbour whose quads are wider than the child.
fn has_far_coarser_neighbour(node: NodeTile) -> bool {
    let at = vec2<i32>(vec2<u32>(node.x, node.y));
    let most = NODE_QUADS_BITS - 1u;
    return is_drawn_coarser(at - vec2<i32>(1, 0), node.level, most)
        || is_drawn_coarser(at + vec2<i32>(1, 0), node.level, most)
        || is_drawn_coarser(at - vec2<i32>(0, 1), node.level, most)
        || is_drawn_coarser(at + vec2<i32>(0, 1), node.level, most);
}

fn should_be_split(node: NodeTile) -> bool {
    if (node.level <= farcry.floor_level) { return false; }
    let low = node_corner(node);
    let high = min(low + quad_size(node.level) * i32(NODE_QUADS), frame.extent.zw);
    return distance_to(prism_over(low, high)) < split_distance(node.level)
        && children_can_be_drawn(node) && !has_far_coarser_neighbour(node);
}

@compute @workgroup_size(64)
fn refine_nodes(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= state.parents) { return; }
    var at = vec2<u32>(0u);
    if (state.level < farcry.root_level) { at = temporary_nodes[temporary_index(id.x, state.level)]; }
    let node = NodeTile(at.x, at.y, state.level);
    if (should_be_split(node)) {
        for (var i = 0u; i < 4u; i += 1u) {
            let child = child_of(node, i);
            if (is_outside(child)) { continue; }
            let slot = temporary_index(atomicAdd(&state.children, 1u), child.level);
            temporary_nodes[slot] = vec2<u32>(child.x, child.y);
        }
    } else {
        nodes[atomicAdd(&state.nodes, 1u)] = node;
        lod_map[map_index(vec2<i32>(at), node.level)] = 1u;
    }
}
