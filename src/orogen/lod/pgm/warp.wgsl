#include pgm.wgsl
// Importance-driven warping (Houska 2019, section 3.4): the importance image, integrated along its columns. A group of
// threads makes one column.

@group(1) @binding(1) var<storage, read_write> integrals: array<f32>;   // IMAGE_ROWS + 1 shares per column

var<workgroup> sums: array<f32, IMAGE_ROWS>;

// Equation 3.5: height over width of a projected cell. A cell counts as no narrower than a column of the picture is at
// its distance: to sample more finely than the picture shows is of no importance.
fn importance(u: f32, t: f32) -> f32 {
    let half = 0.5 / f32(IMAGE_ROWS);
    let near = base_row(t - half);
    let far = base_row(t + half);
    let s = base_row(t);
    let columns = columns_at(s);
    let height = distance(vec2<f32>(near, lateral(u, near)), vec2<f32>(far, lateral(u, far)));
    let width = (columns.y - columns.x) / f32(pgm.columns);
    return height / max(width, pgm.cell_angle * eye_distance(s, lateral(u, s)));
}

@compute @workgroup_size(IMAGE_ROWS)
fn integrate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let row = local.x;
    let u = f32(group.x) / f32(IMAGE_COLUMNS - 1u);
    sums[row] = importance(u, (f32(row) + 0.5) / f32(IMAGE_ROWS));
    workgroupBarrier();
    // parallel prefix sum
    for (var step = 1u; step < IMAGE_ROWS; step *= 2u) {
        var before = 0.0;
        if (row >= step) { before = sums[row - step]; }
        workgroupBarrier();
        sums[row] += before;
        workgroupBarrier();
    }
    let start = group.x * (IMAGE_ROWS + 1u);
    if (row == 0u) { integrals[start] = 0.0; }
    integrals[start + row + 1u] = sums[row] / sums[IMAGE_ROWS - 1u];
}
