#include cbt.wgsl
// The tree (Dupuy 2020): a bit for each place of the deepest level, and sums of bits above it.
//
// A bit is set where a leaf begins. Dividing a node sets the bit where its second half begins, which no other node
// shares: so the set bits are also the set of divided nodes, and threads set and clear them without knowing of one
// another.

const DEPTH = #{DEPTH}u;                     // of the deepest level
const SUMS = 1u << (DEPTH - 5u);             // words of bits come first, then sums as a heap over blocks of 256 bits
const BLOCKS = 1u << (DEPTH - 8u);
const REGIONS = BLOCKS / 256u;
const TOUCHED = SUMS + 2u * BLOCKS;          // then a flag for each region of 256 blocks in which bits have changed
const REGION_LIST = TOUCHED + REGIONS;       // and their numbers
const GROUPS_A_ROW = #{GROUPS_A_ROW}u;

struct State {
    leaves: u32,
    work: u32,                 // nodes that the next update looks at
    half: u32,                 // of the list, in which they are
    updates: u32,              // made in this frame
    settled: u32,              // 1: the last update changed nothing
    unsettled: u32,            // frames so far that ended unsettled or short of room
    refused: atomic<u32>,      // nodes that there was no room for in this frame
    divided: atomic<u32>,      // nodes in this update
    joined: atomic<u32>,
    added: atomic<u32>,        // leaves made in this update: what the next one looks at
    regions: atomic<u32>,      // touched in this frame
    drawn: atomic<u32>,        // triangles in the list
}

@group(1) @binding(1) var<storage, read_write> tree: array<atomic<u32>>;
@group(1) @binding(2) var<storage, read_write> nodes: array<u32>;
@group(1) @binding(3) var<storage, read_write> state: State;

// The bit that is set where a node is divided.
fn bit_of(node: u32) -> u32 {
    return ((2u * node + 1u) << (DEPTH - 1u - depth_of_node(node))) & ((1u << DEPTH) - 1u);
}

fn is_divided(node: u32) -> bool {
    if (depth_of_node(node) >= DEPTH) { return false; }
    let bit = bit_of(node);
    return ((atomicLoad(&tree[bit >> 5u]) >> (bit & 31u)) & 1u) == 1u;
}

fn touch(bit: u32) {
    let region = bit >> 16u;
    if (atomicExchange(&tree[TOUCHED + region], 1u) == 0u) {
        atomicStore(&tree[REGION_LIST + atomicAdd(&state.regions, 1u)], region);
    }
}

// Divide a node; false where it was divided before.
fn divide(node: u32) -> bool {
    let bit = bit_of(node);
    let mask = 1u << (bit & 31u);
    if ((atomicOr(&tree[bit >> 5u], mask) & mask) != 0u) { return false; }
    touch(bit);
    return true;
}

// Make a node a leaf; false where it was none that is divided.
fn join(node: u32) -> bool {
    let bit = bit_of(node);
    let mask = 1u << (bit & 31u);
    if ((atomicAnd(&tree[bit >> 5u], ~mask) & mask) == 0u) { return false; }
    touch(bit);
    return true;
}

fn leaves_below(node: u32) -> u32 {
    let depth = depth_of_node(node);
    if (depth <= DEPTH - 8u) { return atomicLoad(&tree[SUMS + node]); }
    let width = 1u << (DEPTH - depth);
    let start = (node << (DEPTH - depth)) & ((1u << DEPTH) - 1u);
    if (width < 32u) {
        let part = (atomicLoad(&tree[start >> 5u]) >> (start & 31u)) & ((1u << width) - 1u);
        return countOneBits(part);
    }
    var sum = 0u;
    for (var k = 0u; k < width / 32u; k += 1u) { sum += countOneBits(atomicLoad(&tree[(start >> 5u) + k])); }
    return sum;
}

// A leaf by its number from the first: a binary search by sums (Dupuy 2020).
fn leaf_of(number: u32) -> u32 {
    var node = 1u;
    var rest = number;
    var count = state.leaves;
    while (count > 1u) {
        let first_half = leaves_below(2u * node);
        node *= 2u;
        if (rest < first_half) {
            count = first_half;
        } else {
            node += 1u;
            rest -= first_half;
            count -= first_half;
        }
    }
    return node;
}

fn half_of(node: u32, half: u32) -> u32 { return select(2u * node + half, 0u, node == 0u); }

// The node of the same depth across a triangle's longest edge, in the tree or not; 0 where the square ends there.
fn partner_of(node: u32) -> u32 {
    let depth = depth_of_node(node);
    var at = node >> (depth - 1u);
    var across_first = 0u;           // beyond the edge from the apex to `first`
    var across_last = 0u;
    var partner = at ^ 1u;
    for (var k = depth - 1u; k > 0u; k -= 1u) {
        let old_partner = partner;
        if (((node >> (k - 1u)) & 1u) == 0u) {
            partner = half_of(across_first, 1u);
            across_first = 2u * at + 1u;
            across_last = half_of(old_partner, 1u);
            at = 2u * at;
        } else {
            partner = half_of(across_last, 0u);
            across_first = half_of(old_partner, 0u);
            across_last = 2u * at;
            at = 2u * at + 1u;
        }
    }
    return partner;
}

fn number_of(group: vec3<u32>, local: u32) -> u32 { return (group.y * GROUPS_A_ROW + group.x) * 64u + local; }
