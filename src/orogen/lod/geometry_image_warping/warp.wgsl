#include image.wgsl
// Warping: what the pixels of a row (or a column) say is a piecewise linear function, which is sampled anew so that
// equal importance lies between samples. A group of threads warps one line.

struct Lines {
    step: u32,              // pixels between neighbours on a line of the source
    line: u32,              // pixels between lines of it
    new_step: u32,          // likewise of the result
    new_line: u32,
    samples: u32,           // that a line of the result has
    columns: u32,           // 1: the lines are columns, 0: rows
}

@group(1) @binding(1) var<storage, read> source: array<Pixel>;
@group(1) @binding(2) var<storage, read_write> result: array<Pixel>;
@group(1) @binding(3) var<uniform> lines: Lines;

var<workgroup> corners: array<Pixel, SKETCH_SIZE>;
var<workgroup> sums: array<f32, SKETCH_SIZE>;     // importance from the line's start to a corner

// Along the data's axis that the lines were parallel to before they were warped.
fn way_between(a: Pixel, b: Pixel) -> f32 {
    let away = abs(b.at - a.at);
    return select(away.y, away.x, lines.columns != settings.along_x);
}

fn mixed(a: Pixel, b: Pixel, way: f32) -> Pixel {
    // in this form exact where both are the same: borders stay straight
    return Pixel(a.at + (b.at - a.at) * way, a.height + (b.height - a.height) * way,
                 a.importance + (b.importance - a.importance) * way);
}

// Where the importance from the line's start is `wanted`: the inverse, piecewise linear too.
fn sample_at(wanted: f32) -> Pixel {
    var low = 0u;
    var high = SKETCH_SIZE - 1u;
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        if (sums[middle] <= wanted) { low = middle; } else { high = middle; }
    }
    let way = (wanted - sums[low]) / max(sums[high] - sums[low], 1e-30);
    return mixed(corners[low], corners[high], clamp(way, 0.0, 1.0));
}

@compute @workgroup_size(SKETCH_SIZE)
fn warp(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let k = local.x;
    corners[k] = source[group.x * lines.line + k * lines.step];
    workgroupBarrier();
    sums[k] = 0.0;
    if (k > 0u) {
        let a = corners[k - 1u];
        let b = corners[k];
        sums[k] = 0.5 * (a.importance + b.importance) * way_between(a, b);
    }
    workgroupBarrier();
    // parallel prefix sum
    for (var step = 1u; step < SKETCH_SIZE; step *= 2u) {
        var before = 0.0;
        if (k >= step) { before = sums[k - step]; }
        workgroupBarrier();
        sums[k] += before;
        workgroupBarrier();
    }
    let share = sums[SKETCH_SIZE - 1u] / f32(lines.samples - 1u);
    for (var i = k; i < lines.samples; i += SKETCH_SIZE) {
        var pixel = corners[SKETCH_SIZE - 1u];
        if (i + 1u < lines.samples) { pixel = sample_at(f32(i) * share); }
        result[group.x * lines.new_line + i * lines.new_step] = pixel;
    }
}
