// Sums over the threads of a group.

const CHANGED = 0x80000000u;   // of a group's sum: not every triangle stays as it is

var<workgroup> shared_sums: array<u32, GROUP>;

// Sums of what the threads up to and with this one bring.
fn running_sum(thread: u32, value: u32) -> u32 {
    shared_sums[thread] = value;
    workgroupBarrier();
    for (var step = 1u; step < GROUP; step *= 2u) {
        var before = 0u;
        if (thread >= step) { before = shared_sums[thread - step]; }
        workgroupBarrier();
        shared_sums[thread] += before;
        workgroupBarrier();
    }
    return shared_sums[thread];
}
