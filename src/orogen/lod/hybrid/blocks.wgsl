#include frame.wgsl
// The picture in square blocks of pixels.

const BLOCK_BITS = 3u;

struct Block {
    entry: atomic<u32>,   // bits of the greatest reverse depth at which a ray can meet a ray tile here; 0: none
    rays: atomic<u32>,    // that were cast
}

fn block_count() -> vec2<u32> { return (frame.size + (1u << BLOCK_BITS) - 1u) >> vec2<u32>(BLOCK_BITS); }

fn block_index(block: vec2<u32>) -> u32 { return block.y * block_count().x + block.x; }
