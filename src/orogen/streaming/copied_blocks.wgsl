#include clipmap.wgsl
// A software driver reads a uniform invocation by invocation where it stands in a branch or a loop: what shaders read most
// is copied before the first. For shaders with the constants COPIED (software.py).
var<private> frame: FrameBlock;
var<private> clipmap: ClipmapBlock;

fn take_blocks() {
    frame = #{FRAME_BLOCK};
    clipmap = #{CLIPMAP_BLOCK};
}
