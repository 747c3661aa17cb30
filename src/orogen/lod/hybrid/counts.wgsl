// What became of a frame's tiles.
struct Counts {
    tiles: u32,        // all
    triangles: u32,    // of these drawn as triangles
    rays: u32,         // of these ray cast
    steps: u32,        // that rays are expected to take, in units of STEP_UNIT
}

const STEP_UNIT = 64.0;
