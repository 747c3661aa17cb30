#include image.wgsl
#include detail.wgsl
// Heights of the up-sampled geometry image.

@group(1) @binding(1) var<storage, read_write> mesh: array<Pixel>;

@compute @workgroup_size(8, 8)
fn displace(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x > settings.columns || id.y > settings.rows) { return; }
    let k = id.y * (settings.columns + 1u) + id.x;
    let p = ground_of(mesh[k]);
    mesh[k].height = height_at(p) + detail_at(p);
}
