#include pgm.wgsl
#include cells.wgsl
#include lod_vertex.wgsl
// Prisms around the cells that may be wrong, with the cells' own triangles: where they are seen, rays are cast.

@group(1) @binding(2) var<storage, read> placed: array<Placed>;
@group(1) @binding(5) var<storage, read> prisms: array<Prism>;

// Corners of a prism in triangles: 0 to 3 below, 4 to 7 above.
const SIDES = array<u32, 24>(
    0u, 1u, 4u, 1u, 4u, 5u, 1u, 3u, 5u, 3u, 5u, 7u, 3u, 2u, 7u, 2u, 7u, 6u, 2u, 0u, 6u, 0u, 6u, 4u);

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex {
    let prism = prisms[instance];
    let at = vec2<u32>(prism.cell % pgm.columns, prism.cell / pgm.columns);
    var sides = SIDES;
    var turned = triangles_of(at);
    var corner = sides[min(vertex, 23u)];
    if (vertex >= 24u) {
        // lid, floor and the surface between them: two triangles each
        let k = (vertex - 24u) % 6u;
        corner = turned[select(k, k - 2u, k > 2u)];
    }
    let v = placed[vertex_number(at, corner & 3u)];
    var height = v.height;
    if (vertex < 24u) { height = select(prism.low, prism.high, corner > 3u); }
    else if (vertex < 30u) { height = prism.high; }
    else if (vertex < 36u) { height = prism.low; }
    return LodVertex(Point(v.cell, v.frac), height, vec4<f32>(0.5), FLAG, v.levels & 0xffu, v.levels >> 8u);
}
