#include lod/tile_vertex.wgsl
// All tiles.
