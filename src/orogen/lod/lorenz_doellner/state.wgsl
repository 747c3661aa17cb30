// Beside arguments of the draw, how far the frame's update has come.
struct State {
    vertices: u32,                          // arguments of the draw
    instances: u32,
    first_vertex: u32,
    first_instance: u32,
    half: u32,                              // of the buffer where the mesh is that was written last
    count: u32,                             // its triangles
    source: u32,                            // triangles of the mesh that it was made from
    bias: u32,                              // depths that all edges have to do without, for want of room
    updates: u32,                           // times that the mesh was copied for this frame
    running: u32,                           // 1: patterns are not complete yet
    present: u32,                           // 1: there are data to draw
    lacking: atomic<u32>,                   // coarse triangles whose pattern the last copy did not complete
    totals: array<atomic<u32>, 8>,          // triangles of all patterns, per bias
}
