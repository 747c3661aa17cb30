#include rag.wgsl
// Whether an edge needs another vertex, and where: a function of the edge alone, so that both triangles decide alike.

const HEIGHT_DIFFERENCE = #{HEIGHT_DIFFERENCE};
const OBJECT_ERROR = #{OBJECT_ERROR};
const AREA = #{AREA};

// `place`: the sample that the new vertex is put on, where it is not the middle.
struct Decision { split: bool, place: u32 }

// Metres relative to the LOD camera, wherever the picture is seen from.
fn lifted(corner: Vertex) -> vec3<f32> {
    let flat = to_metres(vec2<f32>(cell_of(corner) - rag.anchor) - rag.offset);
    return vec3<f32>(flat, (corner.height - rag.eye_height) * frame.exaggeration - frame.curvature * dot(flat, flat));
}

// Far beside and behind the camera the picture's plane stretches without end: distances take the place of depths there.
fn depth_at(p: vec3<f32>) -> f32 {
    return max(dot(rag.depth.xyz, p) + rag.depth.w, 0.2 * (1.0 - rag.depth.w) * length(p) + 1e-6);
}

fn on_screen(p: vec3<f32>) -> vec2<f32> {
    return vec2<f32>(dot(rag.right.xyz, p), dot(rag.up.xyz, p)) / depth_at(p);
}

// 1 at the eye, `depth_detail` where the data ends (section 5.1.2). That of an edge's nearest point, which no part of
// the edge surpasses: decisions by height differences stay monotonic.
fn weight(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let along = b - a;
    let way = clamp(dot(rag.eye - a, along) / max(dot(along, along), 1e-30), 0.0, 1.0);
    return 1.0 - (1.0 - rag.depth_detail) * min(distance(a + way * along, rag.eye) / rag.far, 1.0);
}

// Sample `n` of an edge, 1 to SAMPLES.
fn sample_cell(a: Vertex, b: Vertex, n: u32) -> vec2<i32> {
    let step = cell_of(b) - cell_of(a);
    let parts = i32(SAMPLES + 1u);
    return cell_of(a) + step / parts * i32(n) + step % parts * i32(n) / parts;
}

fn decide_in_order(a: Vertex, b: Vertex) -> Decision {
    let from_here = lifted(a);
    let to_there = lifted(b);
    if (HEIGHT_DIFFERENCE) {
        let difference = abs(a.height - b.height) * frame.exaggeration;
        return Decision(difference * weight(from_here, to_there) >= rag.threshold, 0u);
    }
    var worst = 0.0;
    var sum = 0.0;
    var place = 1u;
    for (var n = 1u; n <= SAMPLES; n += 1u) {
        // equation 4: how far the surface is from the edge that leaves the vertex out
        let there = lifted(fetched(sample_cell(a, b, n)));
        let left_out = mix(from_here, to_there, f32(n) / f32(SAMPLES + 1u));
        var error = distance(on_screen(there), on_screen(left_out));
        if (OBJECT_ERROR) { error = distance(there, left_out); }
        if (error > worst) { place = n; }
        worst = max(worst, error);
        sum += error;
    }
    if (AREA) {
        // the side of a square as large as the area between the edge and the surface, both seen face on (section 4.5.2)
        let middle = 0.5 * (from_here + to_there);
        let pixels = distance(from_here, to_there) * length(rag.up.xyz) / depth_at(middle);
        worst = sqrt(sum / f32(SAMPLES + 1u) * pixels);
    }
    if (OBJECT_ERROR) { worst *= weight(from_here, to_there); }
    return Decision(worst >= rag.threshold, place);
}

fn comes_first(a: Vertex, b: Vertex) -> bool { return a.x < b.x || (a.x == b.x && a.y < b.y); }

fn decide_on_edge(one: Vertex, other: Vertex) -> Decision {
    if (reach(one, other) <= rag.finest) { return Decision(false, 0u); }
    var ends = array<Vertex, 2>(one, other);
    if (comes_first(other, one)) { ends = array<Vertex, 2>(other, one); }
    return decide_in_order(ends[0], ends[1]);
}

// Where the vertex stands that splits an edge.
fn new_cell(a: Vertex, b: Vertex, place: u32) -> vec2<i32> {
    if (!MOVED) { return middle_cell(a, b); }
    if (comes_first(a, b)) { return sample_cell(a, b, place); }
    return sample_cell(b, a, place);
}
