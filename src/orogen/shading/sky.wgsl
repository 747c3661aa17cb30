// Light of the sun, the sky and the haze between (numbers from light.py). Directions are unit vectors (east, north, up).

struct Light {
    sun: vec3<f32>,           // towards the sun
    haze_density: f32,        // 1 / m at the haze's base; 0: clear
    sun_color: vec3<f32>,
    haze_falloff: f32,        // 1 / m, upwards
    zenith: vec3<f32>,
    haze_base: f32,           // drawn metres of height
    horizon: vec3<f32>,
    padding0: f32,
    skylight: vec3<f32>,      // of the sky on level ground
    padding1: f32,
    bounce: vec3<f32>,        // from the ground on what faces down
    padding2: f32,
}

// The sky in a direction. Below the horizon it is the haze, so that no edge shows where the data ends.
fn sky_color(light: Light, direction: vec3<f32>) -> vec3<f32> {
    let upward = max(direction.z, 0.0);
    let air = mix(light.zenith, light.horizon, exp(-4.0 * upward));
    // not made unit length again: the glow fades downwards and needs no azimuth at the nadir
    let near_sun = dot(vec3<f32>(direction.xy, upward), light.sun) - 1.0;
    let glow = 0.18 * exp(6.0 * near_sun) + 0.35 * exp(120.0 * near_sun) + 4.0 * exp(40000.0 * near_sun);
    return air + light.sun_color * glow;
}

// Light of the sky and of the ground around on a surface.
fn ambient_light(light: Light, normal: vec3<f32>) -> vec3<f32> {
    return mix(light.bounce, light.skylight, 0.5 + 0.5 * normal.z);
}

// Share of the light that comes through haze whose density falls off exponentially with height, between two heights
// (drawn metres) `distance` metres apart.
fn haze_transmittance(light: Light, from_height: f32, to_height: f32, distance: f32) -> f32 {
    let a = max(from_height - light.haze_base, 0.0) * light.haze_falloff;
    let b = max(to_height - light.haze_base, 0.0) * light.haze_falloff;
    let low = min(a, b);
    let rise = abs(b - a);
    // mean of exp(-x) from a to b; by its series where the quotient would cancel
    let mean = exp(-low) * select((1.0 - exp(-rise)) / rise, 1.0 - 0.5 * rise, rise < 1e-3);
    return exp(-distance * light.haze_density * mean);
}
