#include triangle.wgsl

@group(1) @binding(1) var<storage, read> shifts: array<f32>;   // per corner: metres over its place

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex { return corner_vertex(vertex, shifts[vertex]); }
