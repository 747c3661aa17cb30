#include frame.wgsl
// The layout of the depth pyramid: level k has a cell for 4^k x 4^k pixels, which holds their farthest depth; levels 1, 2
// ... lie one after the other, up to a single cell.

fn cells_of(level: u32) -> vec2<u32> { return ((frame.size - 1u) >> vec2<u32>(2u * level)) + 1u; }

fn first_cell(level: u32) -> u32 {
    var first = 0u;
    for (var l = 1u; l < level; l += 1u) {
        let cells = cells_of(l);
        first += cells.x * cells.y;
    }
    return first;
}
