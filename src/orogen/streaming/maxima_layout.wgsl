// Where the levels of a node's maximum pyramid lie in its layer: level 1 at the left, the others under one another to its
// right; level k has NODE_SIZE / 2^k + 1 entries a side.
const NODE_SIZE = 1u << #{NODE_BITS}u;

const MAXIMA_SIZE = vec2<u32>(NODE_SIZE / 2u + NODE_SIZE / 4u + 2u, NODE_SIZE / 2u + #{NODE_BITS}u - 2u);

fn maxima_place(level: u32, entry: vec2<i32>) -> vec2<i32> {
    if (level == 1u) { return entry; }
    let column = NODE_SIZE / 2u + 1u;
    let row = NODE_SIZE / 2u - (NODE_SIZE >> (level - 1u)) + level - 2u;
    return entry + vec2<i32>(vec2<u32>(column, row));
}
