#include triangle.wgsl

fn lod_vertex(vertex: u32, instance: u32) -> LodVertex { return corner_vertex(vertex, 0.0); }
