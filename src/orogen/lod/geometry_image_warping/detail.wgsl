// Procedural detail: noise that is a function of the place in the data alone, within plus and minus DETAIL metres.

const DETAIL = #{DETAIL};                // metres
const DETAIL_SIZE = #{DETAIL_SIZE};      // texels between the lattice points of the coarsest octave
const OCTAVES = 4u;                      // each half as wide and as high as the one before

// From -1 to 1 for each lattice point of an octave (hash of Jarzynski and Olano 2020, PCG2D).
fn random_at(at: vec2<i32>, octave: u32) -> f32 {
    var v = (vec2<u32>(at) + octave * 0x9e3779b9u) * 1664525u + 1013904223u;
    v.x += v.y * 1664525u;
    v.y += v.x * 1664525u;
    v ^= v >> vec2<u32>(16u);
    v.x += v.y * 1664525u;
    v.y += v.x * 1664525u;
    v ^= v >> vec2<u32>(16u);
    return f32(v.x >> 8u) / 8388607.5 - 1.0;
}

fn octave_at(p: Point, width: i32, octave: u32) -> f32 {
    let whole = p.cell - frame.extent.xy;
    let cell = whole / width;
    let way = (vec2<f32>(whole - cell * width) + p.frac) / f32(width);
    let smoothed = way * way * (3.0 - 2.0 * way);
    return bilinear(random_at(cell, octave), random_at(cell + vec2<i32>(1, 0), octave),
                    random_at(cell + vec2<i32>(0, 1), octave), random_at(cell + vec2<i32>(1, 1), octave), smoothed);
}

fn detail_at(p: Point) -> f32 {
    if (DETAIL == 0.0) { return 0.0; }
    var sum = 0.0;
    var most = 0.0;
    for (var octave = 0u; octave < OCTAVES; octave += 1u) {
        let share = inverse_power(octave);
        let width = max(i32(DETAIL_SIZE * share * f32(1u << frame.subtexel_bits)), 1);
        sum += share * octave_at(p, width, octave);
        most += share;
    }
    return DETAIL * sum / most;
}
