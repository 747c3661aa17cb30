#include lod/tile_vertex.wgsl
// Tiles that are drawn as triangles.
