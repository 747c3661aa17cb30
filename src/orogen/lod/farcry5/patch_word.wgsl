// A patch: its place in patches of its level, and how many levels coarser the ground beyond its sides is drawn.

struct PatchTile {
    x: u32,
    y: u32,
    word: u32,    // level, then 4 bits each: west, east, north, south
}

fn make_patch(at: vec2<u32>, level: u32, steps: vec4<u32>) -> PatchTile {
    return PatchTile(at.x, at.y, level | (steps.x << 8u) | (steps.y << 12u) | (steps.z << 16u) | (steps.w << 20u));
}

fn level_of(tile: PatchTile) -> u32 { return tile.word & 0xffu; }

fn steps_of(tile: PatchTile) -> vec4<u32> { return (vec4<u32>(tile.word) >> vec4<u32>(8u, 12u, 16u, 20u)) & vec4<u32>(15u); }
