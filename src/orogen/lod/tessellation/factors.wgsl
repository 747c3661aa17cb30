#include tessellation.wgsl
#include pattern.wgsl
#include frustum.wgsl
// The control stage: how finely edges and patches are divided.

struct Output {
    vertices: u32,                // arguments of the draw
    instances: u32,
    first_vertex: u32,
    first_instance: u32,
    seen: atomic<u32>,            // patches in the frustum
    points: atomic<u32>,          // all that they take, whether or not there is room
    triangles: atomic<u32>,
}

struct Groups { x: u32, y: u32, z: u32 }

@group(1) @binding(1) var<storage, read_write> edges: array<Edge>;
@group(1) @binding(2) var<storage, read_write> patches: array<Patch>;
@group(1) @binding(3) var<storage, read_write> output: Output;
@group(1) @binding(4) var<storage, read_write> dispatch: Groups;      // of `tessellate`

const POWERS_OF_TWO = #{POWERS_OF_TWO};

fn drawn_at(cell: vec2<i32>) -> vec3<f32> {
    let p = Point(cell, vec2<f32>(0.0));
    return lift(flat_position(p), height_at(p));
}

fn distance_to_segment(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let along = b - a;
    let way = clamp(dot(frame.lod_eye - a, along) / max(dot(along, along), 1e-30), 0.0, 1.0);
    return distance(a + way * along, frame.lod_eye);
}

// Edges that run east come first, row by row, then those that run south.
fn edge_number(corner: vec2<u32>, southward: bool) -> u32 {
    let eastward_edges = tessellation.patches.x * (tessellation.patches.y + 1u);
    if (southward) { return eastward_edges + corner.y * (tessellation.patches.x + 1u) + corner.x; }
    return corner.y * tessellation.patches.x + corner.x;
}

// Quads of pixels_per_quad pixels, seen face on (Houska 2019, equation 2.3).
fn factor(size: f32, distance: f32) -> f32 {
    let quads = size * frame.lod_pixels_per_radian / (max(distance, 1e-3) * tessellation.pixels_per_quad);
    let wanted = clamp(quads, 1.0, tessellation.max_factor);
    if (POWERS_OF_TWO) {
        let whole = u32(ceil(wanted));
        return f32(select(2u << firstLeadingBit(whole), whole, countOneBits(whole) == 1u));
    }
    return wanted;
}

// Each edge gets its factor once, for both patches that share it.
@compute @workgroup_size(64)
fn measure_edges(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x == 0u) {
        atomicStore(&output.seen, 0u);
        atomicStore(&output.points, 0u);
        atomicStore(&output.triangles, 0u);
    }
    let eastward_edges = tessellation.patches.x * (tessellation.patches.y + 1u);
    let southward = id.x >= eastward_edges;
    let number = id.x - select(0u, eastward_edges, southward);
    let columns = tessellation.patches.x + u32(southward);
    let corner = vec2<u32>(number % columns, number / columns);
    if (corner.y >= tessellation.patches.y + u32(!southward)) { return; }
    let first = lattice_point(corner);
    let last = lattice_point(corner + select(vec2<u32>(1u, 0u), vec2<u32>(0u, 1u), southward));
    // a chord through three points, so that an edge over a ridge is seen to be near and long
    let a = drawn_at(first);
    let b = drawn_at(first + (last - first) / 2);
    let c = drawn_at(last);
    let size = distance(a, b) + distance(b, c);
    let away = min(distance_to_segment(a, b), distance_to_segment(b, c));
    edges[id.x] = Edge(size, away, factor(size, away));
}

// Distance of the LOD eye to the point of a patch that is under it or nearest to that.
fn inner_distance(corner: vec2<u32>) -> f32 {
    let low = lattice_point(corner);
    let high = lattice_point(corner + 1u);
    let under = point_at(to_subtexels(frame.lod_eye.xy) + frame.eye_offset).cell;
    return distance(drawn_at(clamp(under, low, high)), frame.lod_eye);
}

// Whether the box of everything drawn over a patch touches the LOD camera's frustum.
fn in_frustum(corner: vec2<u32>) -> bool {
    // before the first data has come there is nothing to draw
    if (clipmap.layers[HEIGHTS].present == 0u) { return false; }
    return !rectangle_outside(lattice_point(corner), lattice_point(corner + 1u));
}

@compute @workgroup_size(64)
fn plan_patches(@builtin(global_invocation_id) id: vec3<u32>) {
    let corner = vec2<u32>(id.x % tessellation.patches.x, id.x / tessellation.patches.x);
    if (corner.y >= tessellation.patches.y || !in_frustum(corner)) { return; }
    let west = edges[edge_number(corner, true)];
    let north = edges[edge_number(corner, false)];
    let east = edges[edge_number(corner + vec2<u32>(1u, 0u), true)];
    let south = edges[edge_number(corner + vec2<u32>(0u, 1u), false)];
    let outer = vec4<f32>(west.factor, north.factor, east.factor, south.factor);
    let outline = min(min(west.distance, east.distance), min(north.distance, south.distance));
    let nearest = min(outline, inner_distance(corner));
    let inner = vec2<f32>(factor(max(north.size, south.size), nearest), factor(max(west.size, east.size), nearest));
    let pattern = pattern_of(outer, inner);
    let first_point = atomicAdd(&output.points, pattern.points);
    let first_triangle = atomicAdd(&output.triangles, pattern.triangles);
    patches[atomicAdd(&output.seen, 1u)] = Patch(corner, first_point, first_triangle, outer, inner, vec2<u32>(0u));
}

@compute @workgroup_size(1)
fn prepare() {
    let seen = atomicLoad(&output.seen);
    let triangles = atomicLoad(&output.triangles);
    dispatch = Groups(min(seen, GROUPS_A_ROW), (seen + GROUPS_A_ROW - 1u) / GROUPS_A_ROW, 1u);
    // without room for all, patches stay whole: coarse is better than a hole, until the buffers have grown
    output.vertices = 3u * select(2u * seen, triangles, triangles <= tessellation.capacity);
    output.instances = 1u;
}
