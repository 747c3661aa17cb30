// Stand-in for the frame: the same names, only what shading reads.
struct FrameBlock {
    right: vec4<f32>,
    up: vec4<f32>,
    forward: vec4<f32>,
    subtexels: vec4<f32>,
    size: vec2<u32>,
    jitter: vec2<f32>,
    anchor: vec2<i32>,
    eye_offset: vec2<f32>,
    near: f32,
    depth_near: f32,
    depth_far: f32,
    eye_height: f32,
    exaggeration: f32,
    spacing: f32,
    subtexel_bits: u32,
    padding: f32,
}

struct Point { cell: vec2<i32>, frac: vec2<f32> }
struct Ray { origin: vec3<f32>, direction: vec3<f32> }

@group(0) @binding(0) var<uniform> #{FRAME_BLOCK}: FrameBlock;

fn to_subtexels(metres: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(dot(frame.subtexels.xy, metres), dot(frame.subtexels.zw, metres));
}

fn ground_point(position: vec3<f32>) -> Point {
    let offset = to_subtexels(position.xy) + frame.eye_offset;
    let whole = floor(offset);
    return Point(frame.anchor + vec2<i32>(whole), offset - whole);
}

fn world_height(position: vec3<f32>) -> f32 { return position.z / frame.exaggeration + frame.eye_height; }

fn pixel_ray(pixel: vec2<u32>) -> Ray {
    let ndc = ((vec2<f32>(pixel) + 0.5 + frame.jitter) / vec2<f32>(frame.size) * 2.0 - 1.0) * vec2<f32>(1.0, -1.0);
    let plane = ndc.x * frame.right.xyz + ndc.y * frame.up.xyz;
    if (frame.forward.w > 0.5) { return Ray(plane, frame.forward.xyz); }
    return Ray(vec3<f32>(0.0), plane + frame.forward.xyz);
}

fn view_depth(depth: f32) -> f32 {
    if (frame.forward.w > 0.5) { return frame.depth_far - depth * (frame.depth_far - frame.depth_near); }
    return frame.near / depth;
}
