#include gamer.wgsl
#include frustum.wgsl
// The pattern of each coarse triangle in the frustum, and how often each pattern occurs in a workgroup.

const PATTERNS = #{PATTERNS}u;
const NONE = 0xffffffffu;

@group(1) @binding(1) var<storage, read> vertices: array<CoarseVertex>;
@group(1) @binding(2) var<storage, read_write> choices: array<u32>;  // pattern << 9 | deepest edge << 6 | corner order
@group(1) @binding(3) var<storage, read_write> counts: array<u32>;     // pattern by pattern, each workgroup's

var<workgroup> histogram: array<atomic<u32>, PATTERNS>;

fn tag_of(corner: vec2<u32>) -> f32 { return vertices[corner.y * (gamer.cells.x + 1u) + corner.x].tag; }

// The tags at its two ends decide on an edge: the same for the triangles on both sides, to the bit.
fn edge_depth(one: vec2<u32>, other: vec2<u32>) -> u32 { return u32(ceil(0.5 * (tag_of(one) + tag_of(other)))); }

// Whether the prism of everything drawn over a triangle touches the LOD camera's frustum.
fn in_frustum(corners: array<vec2<u32>, 3>) -> bool {
    let one = lattice_point(corners[1]);
    let other = lattice_point(corners[2]);
    let a = flat_position(Point(lattice_point(corners[0]), vec2<f32>(0.0)));
    let b = flat_position(Point(one, vec2<f32>(0.0)));
    let c = flat_position(Point(other, vec2<f32>(0.0)));
    return !prism_outside(a, b, c, c, bounds_around(min(one, other), max(one, other)));
}

// The pool holds depths in descending order: (i, j, k) is number C(i + 2, 3) + C(j + 1, 2) + k.
fn pattern_number(d: vec3<u32>) -> u32 { return d.x * (d.x + 1u) * (d.x + 2u) / 6u + d.y * (d.y + 1u) / 2u + d.z; }

// Edge k lies opposite corner k: corners are put into the descending order of their edges' depths.
fn choice(corners: array<vec2<u32>, 3>) -> u32 {
    var depths = vec3<u32>(edge_depth(corners[1], corners[2]), edge_depth(corners[2], corners[0]),
                           edge_depth(corners[0], corners[1]));
    var order = vec3<u32>(0u, 1u, 2u);
    if (depths.x < depths.y) { depths = depths.yxz; order = order.yxz; }
    if (depths.y < depths.z) { depths = depths.xzy; order = order.xzy; }
    if (depths.x < depths.y) { depths = depths.yxz; order = order.yxz; }
    return pattern_number(depths) << 9u | depths.x << 6u | order.z << 4u | order.y << 2u | order.x;
}

@compute @workgroup_size(128)
fn choose_patterns(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if (thread < PATTERNS) { atomicStore(&histogram[thread], 0u); }
    workgroupBarrier();
    let triangle = group.x * 128u + thread;
    let corners = corners_of(triangle);
    var chosen = NONE;
    // before the first data has come there is nothing to draw
    if (triangle < 2u * gamer.cells.x * gamer.cells.y && clipmap.layers[HEIGHTS].present == 1u && in_frustum(corners)) {
        chosen = choice(corners);
        atomicAdd(&histogram[chosen >> 9u], 1u);
    }
    choices[triangle] = chosen;
    workgroupBarrier();
    if (thread < PATTERNS) { counts[thread * gamer.groups + group.x] = atomicLoad(&histogram[thread]); }
}
