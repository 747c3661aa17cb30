// Lines and tints that explain a picture.

// Eight colours that stay distinct with every kind of colour vision (M. Okabe and K. Ito, Color universal design, 2008),
// linear RGB.
const LEVEL_COLORS = array<vec3<f32>, 8>(
    vec3<f32>(0.672, 0.076, 0.0), vec3<f32>(0.791, 0.347, 0.0), vec3<f32>(0.871, 0.776, 0.054),
    vec3<f32>(0.0, 0.342, 0.171), vec3<f32>(0.093, 0.456, 0.815), vec3<f32>(0.0, 0.168, 0.445),
    vec3<f32>(0.604, 0.191, 0.386), vec3<f32>(0.6, 0.6, 0.6));

fn level_color(level: u32) -> vec3<f32> {
    var colors = LEVEL_COLORS;
    return colors[level & 7u];
}

// 0: green, through yellow, 1 and above: red (as T. Schmiade, Adaptive GPU-based terrain rendering, 2008, shows errors).
fn heat_color(share: f32) -> vec3<f32> {
    let x = 2.0 * clamp(share, 0.0, 1.0);
    return vec3<f32>(min(x, 1.0), min(2.0 - x, 1.0), 0.0);
}

// Share of a pixel under a line of `width` pixels whose middle is `distance` pixels away.
fn line_cover(distance: f32, width: f32) -> f32 {
    return clamp(0.5 * width + 0.5 - distance, 0.0, 1.0) * min(width, 1.0);
}

// Cover of the lines where `value` is a multiple of `interval`; `slope`: change of the value per pixel.
fn isoline_cover(value: f32, interval: f32, slope: f32, width: f32) -> f32 {
    let away = abs(value - round(value / interval) * interval);
    let spacing = interval / max(slope, 1e-30);
    // lines that would melt into a grey fade out
    return line_cover(away / max(slope, 1e-30), width) * smoothstep(2.0 * width, 5.0 * width, spacing);
}

// Contours, every fifth thicker. `slope`: data metres per pixel; `tilt`: steepness of the ground, so that a lake at just
// the height of a contour is no blot.
fn contour_cover(height: f32, interval: f32, slope: f32, tilt: f32) -> f32 {
    let cover = max(isoline_cover(height, interval, slope, 1.0), isoline_cover(height, 5.0 * interval, slope, 2.0));
    return cover * smoothstep(1e-5, 1e-4, tilt);
}
