// How the node atlas stores heights: as heightformat.py says, floats in metres or whole numbers of 16 bits.
const HEIGHT_BITS = #{HEIGHT_BITS}u;
const HEIGHT_STEP = f32(#{HEIGHT_STEP});
const HEIGHT_BASE = f32(#{HEIGHT_BASE});

alias HeightTexel = #{HEIGHT_TYPE};

fn height_of(texel: HeightTexel) -> f32 {
    if (HEIGHT_BITS == 32u) { return f32(texel); }
    return HEIGHT_BASE + HEIGHT_STEP * f32(texel);
}

fn heights_of(texels: vec4<HeightTexel>) -> vec4<f32> {
    if (HEIGHT_BITS == 32u) { return vec4<f32>(texels); }
    return HEIGHT_BASE + HEIGHT_STEP * vec4<f32>(texels);
}
