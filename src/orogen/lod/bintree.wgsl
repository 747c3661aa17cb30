#include clipmap.wgsl
// Triangles of a bintree (bintree.py) as points of the terrain.

struct Triangle { middle: vec2<i32>, apex: vec2<i32> }   // of the longest side, and across it; units of the lattice

const UNIT = #{UNIT};   // subtexels of a unit

@group(1) @binding(0) var<storage, read> triangles: array<Triangle>;

// The ends of the longest side are a quarter turn from the apex; corner 0 is the apex.
fn corner_of(triangle: Triangle, corner: u32) -> vec2<i32> {
    let way = triangle.apex - triangle.middle;
    let turned = vec2<i32>(-way.y, way.x);
    if (corner == 0u) { return triangle.apex; }
    return triangle.middle + select(turned, -turned, corner == 2u);
}

fn lattice_point(subtexels: vec2<i32>) -> Point {
    return Point(frame.extent.xy + subtexels, vec2<f32>(0.0));
}

// Beyond the raster the ground is reflected in its edge, z(last + k) = 2 z(last) - z(last - k): planes stay planes.
fn height_beyond(p: Point) -> f32 {
    let over = max(p.cell - frame.extent.zw, vec2<i32>(0));
    if (all(over == vec2<i32>(0))) { return height_at(p); }
    let edge = p.cell - over;
    let back = max(edge - over, frame.extent.xy);
    let zero = vec2<f32>(0.0);
    if (over.y == 0) { return 2.0 * height_at(Point(edge, zero)) - height_at(Point(vec2<i32>(back.x, edge.y), zero)); }
    let above = Point(vec2<i32>(edge.x, back.y), zero);
    let beside = 2.0 * height_at(Point(edge, zero)) - height_at(above);
    if (over.x == 0) { return beside; }
    let left = 2.0 * height_at(Point(vec2<i32>(back.x, edge.y), zero)) - height_at(Point(back, zero));
    return 2.0 * beside - left;
}

// Bintree levels above the smallest triangles there can be.
fn level_of(triangle: Triangle) -> u32 {
    let way = abs(triangle.apex - triangle.middle);
    let s = u32(max(way.x, way.y));
    return 2u * firstLeadingBit(s) + select(0u, 1u, way.x != 0 && way.y != 0);
}

fn id_of(triangle: Triangle) -> u32 {
    let m = vec2<u32>(triangle.middle);
    let way = triangle.apex - triangle.middle;
    let below = select(0u, 1u << 31u, way.y > 0 || (way.y == 0 && way.x > 0));
    return below ^ (m.y << 13u) ^ (m.y >> 16u) ^ m.x;
}
