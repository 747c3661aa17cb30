// Stand-in for the blocks as GPUs read them.

fn take_blocks() {}
