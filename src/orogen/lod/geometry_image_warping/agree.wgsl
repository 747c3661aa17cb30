#include image.wgsl
// Between the warps: each pixel of a row is made as important as the row is on average, so that all columns are warped
// alike. A group of threads averages one row.

const THREADS = 64u;

@group(1) @binding(1) var<storage, read_write> image: array<Pixel>;   // columns + 1 pixels a row

var<workgroup> sums: array<f32, THREADS>;

@compute @workgroup_size(THREADS)
fn agree(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let width = settings.columns + 1u;
    let start = group.x * width;
    var sum = 0.0;
    for (var i = local.x; i < width; i += THREADS) { sum += image[start + i].importance; }
    sums[local.x] = sum;
    workgroupBarrier();
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        if (local.x < half) { sums[local.x] += sums[local.x + half]; }
        workgroupBarrier();
    }
    let mean = sums[0] / f32(width);
    for (var i = local.x; i < width; i += THREADS) { image[start + i].importance = mean; }
}
