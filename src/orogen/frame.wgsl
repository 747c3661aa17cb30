// The frame to draw (frame.py): camera, picture and working grid. Camera-relative metres are (east, north, up).

struct FrameBlock {
    view_projection: mat4x4<f32>,   // camera-relative metres to clip space, reverse z
    right: vec4<f32>,               // picture's half width: scaled axis (metres at view depth 1, or metres if orthographic)
    up: vec4<f32>,                  // picture's half height, likewise
    forward: vec4<f32>,             // unit view axis; w is 1 for an orthographic camera
    metres: vec4<f32>,              // 2 x 2, rows first: subtexels to metres (east, north)
    subtexels: vec4<f32>,           // its inverse
    anchor: vec2<i32>,              // subtexels that all horizontal positions are taken relative to
    eye_offset: vec2<f32>,          // camera minus anchor, subtexels
    size: vec2<u32>,                // pixels
    jitter: vec2<f32>,              // of the sample in its pixel, pixels
    lod_eye: vec3<f32>,             // where distances for levels of detail start, camera-relative metres
    pixels_per_radian: f32,         // v of equation 2.3 (Houska 2019) of the view camera
    eye_height: f32,                // camera's height in metres of the data (exaggeration undone), rounded; see eye_rest
    exaggeration: f32,
    curvature: f32,                 // 1 / 2R or 0
    near: f32,                      // near plane of a perspective camera
    depth_near: f32,                // view depths of an orthographic camera's planes
    depth_far: f32,
    height_min: f32,                // valid heights of the data
    height_max: f32,
    ground: f32,                    // approximate ground under the LOD camera, camera-relative metres
    spacing: f32,                   // metres between level-0 samples
    subtexel_bits: u32,
    slice: u32,
    extent: vec4<i32>,              // drawn area in subtexels: left, top, right, bottom
    planes: array<vec4<f32>, 5>,    // frustum of the LOD camera, camera-relative metres, positive inside
    lod_pixels_per_radian: f32,     // v of the LOD camera
    pixel_metres: f32,              // metres that a pixel covers, orthographic; 0 for perspective
    eye_rest: f32,                  // camera's height minus eye_height
    padding: f32,
}

// A horizontal position: absolute subtexels, and the fraction that rounds down to them.
struct Point { cell: vec2<i32>, frac: vec2<f32> }

struct Ray { origin: vec3<f32>, direction: vec3<f32> }

@group(0) @binding(0) var<uniform> #{FRAME_BLOCK}: FrameBlock;

fn to_metres(offset: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(dot(frame.metres.xy, offset), dot(frame.metres.zw, offset));
}

fn to_subtexels(metres: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(dot(frame.subtexels.xy, metres), dot(frame.subtexels.zw, metres));
}

// Point at an offset in subtexels from the anchor.
fn point_at(offset: vec2<f32>) -> Point {
    let whole = floor(offset);
    return Point(frame.anchor + vec2<i32>(whole), offset - whole);
}

fn clamp_to_extent(p: Point) -> Point {
    let low = p.cell < frame.extent.xy;
    let high = p.cell >= frame.extent.zw;
    return Point(clamp(p.cell, frame.extent.xy, frame.extent.zw), select(p.frac, vec2<f32>(0.0), low | high));
}

// Camera-relative metres (east, north) of a point.
fn flat_position(p: Point) -> vec2<f32> {
    return to_metres((vec2<f32>(p.cell - frame.anchor) - frame.eye_offset) + p.frac);
}

// Camera-relative position of a height in metres of the data at a camera-relative (east, north).
fn lift(flat: vec2<f32>, height: f32) -> vec3<f32> {
    let above = (height - frame.eye_height) - frame.eye_rest;
    return vec3<f32>(flat, above * frame.exaggeration - frame.curvature * dot(flat, flat));
}

fn ground_point(position: vec3<f32>) -> Point {
    return point_at(to_subtexels(position.xy) + frame.eye_offset);
}

fn world_height(position: vec3<f32>) -> f32 {
    let above = (position.z + frame.curvature * dot(position.xy, position.xy)) / frame.exaggeration;
    return (above + frame.eye_rest) + frame.eye_height;
}

// The point at view depth t is origin + t * direction.
fn pixel_ray(pixel: vec2<u32>) -> Ray {
    let centre = vec2<f32>(pixel) + 0.5 + frame.jitter;
    let ndc = (centre / vec2<f32>(frame.size) * 2.0 - 1.0) * vec2<f32>(1.0, -1.0);
    let plane = ndc.x * frame.right.xyz + ndc.y * frame.up.xyz;
    if (frame.forward.w > 0.5) { return Ray(plane, frame.forward.xyz); }
    return Ray(vec3<f32>(0.0), plane + frame.forward.xyz);
}

fn view_depth(depth: f32) -> f32 {
    if (frame.forward.w > 0.5) { return frame.depth_far - depth * (frame.depth_far - frame.depth_near); }
    return frame.near / depth;
}

fn depth_of(t: f32) -> f32 {
    if (frame.forward.w > 0.5) { return (frame.depth_far - t) / (frame.depth_far - frame.depth_near); }
    return frame.near / t;
}

// Pixels that a metre across the view covers at view depth t.
fn pixels_per_metre(t: f32) -> f32 {
    if (frame.pixel_metres > 0.0) { return 1.0 / frame.pixel_metres; }
    return frame.pixels_per_radian / t;
}

// Distance for the level of detail, with the approximate ground in place of the height (Kuehnert 2022, equation 4.7).
fn lod_distance(flat: vec2<f32>) -> f32 {
    return distance(vec3<f32>(flat, frame.ground), frame.lod_eye);
}
