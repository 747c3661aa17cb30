// Arguments of the dispatches that work off the queues.

const ROW = 4096u;

struct Queues { large: u32, pieces: u32, blocks: u32, most_large: u32, most_pieces: u32, most_blocks: u32 }

@group(0) @binding(0) var<storage, read_write> queues: Queues;
@group(0) @binding(1) var<storage, read_write> split_groups: array<u32, 3>;
@group(0) @binding(2) var<storage, read_write> block_groups: array<u32, 3>;

@compute @workgroup_size(1)
fn prepare_split() {
    queues.most_large = max(queues.most_large, queues.large);
    split_groups[0] = min((queues.large + 63u) / 64u, #{MOST_LARGE}u / 64u);
    split_groups[1] = 1u;
    split_groups[2] = 1u;
}

@compute @workgroup_size(1)
fn prepare_blocks() {
    queues.most_pieces = max(queues.most_pieces, queues.pieces);
    queues.most_blocks = max(queues.most_blocks, queues.blocks);
    let count = min(queues.blocks, #{MOST_BLOCKS}u);
    block_groups[0] = min(count, ROW);
    block_groups[1] = (count + ROW - 1u) / ROW;
    block_groups[2] = 1u;
}
