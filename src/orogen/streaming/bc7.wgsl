// Colours as BC7 blocks of mode 6: two end points of 8 bits a channel, whose lowest bits agree, and an index of 4 bits for
// each of 4 x 4 texels. The end points lie on the principal axis of the texels; fitted once to the indices found by least
// squares, they are replaced where that is better. An invocation per block.

struct Mip {
    size: vec2<u32>,    // texels
    texel: u32,         // its first one
    block: u32,         // its first one, of all mip levels
    word: u32,          // the first one of its blocks
    pitch: u32,         // words from one row of blocks to the next
    padding: vec2<u32>,
}

const MIPS = #{MIPS}u;
const GROUP = #{GROUP}u;

@group(0) @binding(0) var<storage, read> pixels: array<u32>;
@group(0) @binding(1) var<storage, read_write> blocks: array<u32>;
@group(0) @binding(2) var<uniform> mips: array<Mip, MIPS>;

var<private> texels: array<vec4<f32>, 16>;
var<private> words: array<u32, 4>;
var<private> bits: u32;

// Sixty-fourths of the second end point.
fn weight_of(index: u32) -> u32 { return (index * 64u + 7u) / 15u; }

struct Line { from_end: vec4<f32>, to_end: vec4<f32> }

fn line_through() -> Line {
    var middle = vec4<f32>(0.0);
    for (var t = 0; t < 16; t += 1) { middle += texels[t]; }
    middle /= 16.0;
    var spread = mat4x4<f32>();
    for (var t = 0; t < 16; t += 1) {
        let off = texels[t] - middle;
        spread += mat4x4<f32>(off * off.x, off * off.y, off * off.z, off * off.w);
    }
    // powers of the spread turn its longest column to the axis
    var axis = spread[0];
    var longest = spread[0].x;
    for (var i = 1; i < 4; i += 1) {
        if (spread[i][i] > longest) { axis = spread[i]; longest = spread[i][i]; }
    }
    for (var i = 0; i < 6; i += 1) {
        let size = abs(axis);
        axis = spread * (axis / max(max(max(size.x, size.y), max(size.z, size.w)), 1e-12));
    }
    axis /= max(length(axis), 1e-12);
    var span = vec2<f32>(1e30, -1e30);
    for (var t = 0; t < 16; t += 1) {
        let way = dot(texels[t] - middle, axis);
        span = vec2<f32>(min(span.x, way), max(span.y, way));
    }
    return Line(middle + axis * span.x, middle + axis * span.y);
}

fn nearest(end: vec4<f32>, low_bit: f32) -> vec4<f32> {
    return 2.0 * clamp(floor((end - low_bit) * 0.5 + 0.5), vec4<f32>(0.0), vec4<f32>(127.0)) + low_bit;
}

// The nearer end point of 8 bits; what is opaque, or empty, stays so.
fn quantized(end: vec4<f32>, alpha: vec2<f32>) -> vec4<f32> {
    let even = nearest(end, 0.0);
    let odd = nearest(end, 1.0);
    var is_odd = dot(odd - end, odd - end) < dot(even - end, even - end);
    if (alpha.x == 255.0) { is_odd = true; }
    if (alpha.y == 0.0) { is_odd = false; }
    return select(even, odd, is_odd);
}

fn quantized_line(line: Line, alpha: vec2<f32>) -> Line {
    return Line(quantized(line.from_end, alpha), quantized(line.to_end, alpha));
}

fn color_at(line: Line, index: u32) -> vec4<f32> {
    let w = f32(weight_of(index));
    return floor(((64.0 - w) * line.from_end + w * line.to_end + 32.0) / 64.0);
}

struct Fit { indices: array<u32, 16>, error: f32 }

fn indices_of(line: Line) -> Fit {
    var fit: Fit;
    let along = line.to_end - line.from_end;
    let scale = 15.0 / max(dot(along, along), 1e-12);
    for (var t = 0; t < 16; t += 1) {
        let guess = i32(clamp(floor(dot(texels[t] - line.from_end, along) * scale + 0.5), 0.0, 15.0));
        var least = 1e30;
        for (var i = 0; i < 3; i += 1) {
            // the guess, the one before and the one after
            let index = u32(clamp(guess + (i & 1) * -1 + (i >> 1u), 0, 15));
            let off = color_at(line, index) - texels[t];
            if (dot(off, off) < least) { least = dot(off, off); fit.indices[t] = index; }
        }
        fit.error += least;
    }
    return fit;
}

// End points with the least squared error for given indices; the old ones where these do not tell.
fn fitted(indices: array<u32, 16>, old: Line) -> Line {
    var chosen = indices;
    var sums = vec3<f32>(0.0);
    var a = vec4<f32>(0.0);
    var b = vec4<f32>(0.0);
    for (var t = 0; t < 16; t += 1) {
        let w = f32(weight_of(chosen[t])) / 64.0;
        sums += vec3<f32>((1.0 - w) * (1.0 - w), (1.0 - w) * w, w * w);
        a += (1.0 - w) * texels[t];
        b += w * texels[t];
    }
    let det = sums.x * sums.z - sums.y * sums.y;
    if (det <= 1e-3) { return old; }
    return Line((sums.z * a - sums.y * b) / det, (sums.x * b - sums.y * a) / det);
}

fn put(value: u32, width: u32) {
    let shift = bits & 31u;
    words[bits >> 5u] |= value << shift;
    if (shift + width > 32u) { words[(bits >> 5u) + 1u] |= value >> (32u - shift); }
    bits += width;
}

@compute @workgroup_size(GROUP)
fn compress(@builtin(global_invocation_id) id: vec3<u32>) {
    var m = MIPS - 1u;
    while (id.x < mips[m].block) { m -= 1u; }
    let mip = mips[m];
    let number = id.x - mip.block;
    let columns = (mip.size.x + 3u) / 4u;
    let place = vec2<u32>(number % columns, number / columns);
    if (place.y >= (mip.size.y + 3u) / 4u) { return; }
    var alpha = vec2<f32>(255.0, 0.0);
    for (var t = 0u; t < 16u; t += 1u) {
        let at = min(4u * place + vec2<u32>(t & 3u, t >> 2u), mip.size - 1u);
        texels[t] = round(unpack4x8unorm(pixels[mip.texel + at.y * mip.size.x + at.x]) * 255.0);
        alpha = vec2<f32>(min(alpha.x, texels[t].w), max(alpha.y, texels[t].w));
    }
    var line = quantized_line(line_through(), alpha);
    var fit = indices_of(line);
    let other = quantized_line(fitted(fit.indices, line), alpha);
    let again = indices_of(other);
    if (again.error < fit.error) { fit = again; line = other; }
    // the first index has three bits
    let turned = fit.indices[0] >= 8u;
    let a = vec4<u32>(select(line.from_end, line.to_end, turned));
    let b = vec4<u32>(select(line.to_end, line.from_end, turned));
    put(64u, 7u);
    for (var i = 0; i < 4; i += 1) {
        put(a[i] >> 1u, 7u);
        put(b[i] >> 1u, 7u);
    }
    put(a.x & 1u, 1u);
    put(b.x & 1u, 1u);
    for (var t = 0; t < 16; t += 1) {
        put(select(fit.indices[t], 15u - fit.indices[t], turned), select(4u, 3u, t == 0));
    }
    let word = mip.word + place.y * mip.pitch + place.x * 4u;
    for (var i = 0u; i < 4u; i += 1u) { blocks[word + i] = words[i]; }
}
