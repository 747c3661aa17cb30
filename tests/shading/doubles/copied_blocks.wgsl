// Stand-in for the copies of software drivers: of the frame alone.
var<private> frame: FrameBlock;

fn take_blocks() { frame = #{FRAME_BLOCK}; }
