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
    error_reach: f32,             // distance within which an error of a metre is too large; 0: errors do not count
}

// Corners in subtexels from the first sample; `first`, `last` and `apex` turn the same way in all triangles.
struct Triangle { apex: vec2<i32>, first: vec2<i32>, last: vec2<i32> }

@group(1) @binding(0) var<uniform> cbt: Cbt;

fn depth_of_node(node: u32) -> u32 { return firstLeadingBit(node); }

// The half of the square that a node is in.
fn outermost(node: u32) -> Triangle {
    let side = cbt.side;
    let far = i32((node >> (depth_of_node(node) - 1u)) & 1u) * side;
    return Triangle(vec2<i32>(far), vec2<i32>(far, side - far), vec2<i32>(side - far, far));
}

// The half of a triangle whose number ends in a bit.
fn half_of_triangle(t: Triangle, bit: u32) -> Triangle {
    let middle = (t.first + t.last) / 2;
    if (bit == 0u) { return Triangle(middle, t.apex, t.first); }
    return Triangle(middle, t.last, t.apex);
}

fn triangle_of(node: u32) -> Triangle {
    var t = outermost(node);
    for (var k = depth_of_node(node) - 1u; k > 0u; k -= 1u) { t = half_of_triangle(t, (node >> (k - 1u)) & 1u); }
    return t;
}
