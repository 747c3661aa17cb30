#include clipmap.wgsl
// Stand-in for shadow rays: a wall shades everything east of a line.
fn occluded(position: vec3<f32>, direction: vec3<f32>) -> bool { return position.x > scene.shadow_east; }
