// The blocks of the frame and the clipmap as they are, for GPUs, which read uniforms fast anywhere.

fn take_blocks() {}
