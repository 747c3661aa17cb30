// What is known of a patch from its vertices.

struct Box {
    low: vec3<f32>,     // camera-relative metres
    front: u32,         // 1: a triangle may show its upper side to the eye
    high: vec3<f32>,
}
