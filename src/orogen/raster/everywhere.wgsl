// A ray in every pixel.

fn should_cast(pixel: vec2<u32>) -> bool { return true; }
