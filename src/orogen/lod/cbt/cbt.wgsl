#include clipmap.wgsl
// Concurrent binary trees with longest edge bisection (Dupuy 2020): where the triangle of a node lies.
//
// Nodes are numbered as in a heap: 1 is the square over the data, 2 and 3 its halves, 2n and 2n + 1 the halves of n.
// Every triangle is right-angled at its apex and divided from there to the middle of its longest edge.

struct Cbt {
    side: i32,                    // subtexels along the square
    finest: u32,                  // depth at which nodes are divided no more
    capacity: u32,                // nodes that the list has room for
    reach: f32,                   // metres within which nodes of depth 1 are divided
    planes: array<vec4<f32>, 5>,  // the LOD camera's frustum, whatever the sample within the pixel
}

// Corners in subtexels from the first sample; `first`, `last` and `apex` turn the same way in all triangles.
struct Triangle { apex: vec2<i32>, first: vec2<i32>, last: vec2<i32> }

@group(1) @binding(0) var<uniform> cbt: Cbt;

fn depth_of_node(node: u32) -> u32 { return firstLeadingBit(node); }

fn triangle_of(node: u32) -> Triangle {
    let depth = depth_of_node(node);
    let side = cbt.side;
    let far = i32((node >> (depth - 1u)) & 1u) * side;
    var t = Triangle(vec2<i32>(far), vec2<i32>(far, side - far), vec2<i32>(side - far, far));
    for (var k = depth - 1u; k > 0u; k -= 1u) {
        let middle = (t.first + t.last) / 2;
        if (((node >> (k - 1u)) & 1u) == 0u) {
            t = Triangle(middle, t.apex, t.first);
        } else {
            t = Triangle(middle, t.last, t.apex);
        }
    }
    return t;
}
