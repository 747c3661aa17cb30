// What the three passes hand on (Schmiade 2008, section 4.7).

const COLUMNS = #{COLUMNS}u;                // cells of the coarse mesh, two triangles each
const ROWS = #{ROWS}u;
const COARSE = 2u * COLUMNS * ROWS;         // its triangles
const DEPTH = #{DEPTH}u;                    // halvings of an edge at most
const NUMBER_BITS = #{NUMBER_BITS}u;                    // of a triangle's number in its pattern
const GROUP = #{GROUP}u;                    // threads of a workgroup

// A triangle of the intermediate mesh: its corners within its coarse triangle, and which triangle of which that is.
struct SubTriangle { corners: array<u32, 3>, key: u32 }

// A coarse triangle: the result of pattern selection, and how far its pattern has been copied.
struct Coarse {
    depths: u32,            // of its edges, 4 bits each
    previous: u32,          // triangles of the pattern that the source mesh holds
    available: u32,         // those that the target mesh holds
    base: u32,              // first of these, counted from the first of the block of GROUP coarse triangles
}

// A block of coarse triangles: how many triangles the target mesh holds of it, and the first of them.
struct Block { count: u32, first: u32 }

fn packed(depths: vec3<u32>) -> u32 { return depths.x | depths.y << 4u | depths.z << 8u; }

// Row of the access table: the pattern for these depths less a bias.
fn pattern_number(depths: u32, bias: u32) -> u32 {
    let wanted = vec3<u32>(depths, depths >> 4u, depths >> 8u) & vec3<u32>(15u);
    let d = wanted - min(wanted, vec3<u32>(bias));
    return (d.x * (DEPTH + 1u) + d.y) * (DEPTH + 1u) + d.z;
}
