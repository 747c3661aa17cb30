// From the arguments of indirect draws to workgroups.

const MESHES = 0u;
const STRIPS = 2u;
const KIND = #{RASTER_KIND}u;
const TRIANGLES = #{RASTER_TRIANGLES}u;    // of a workgroup
const MAX_DRAWS = #{RASTER_MAX_DRAWS}u;
const ROW = 4096u;

// Of an indexed draw; without an index list the third is the first vertex.
struct Arguments { count: u32, instances: u32, first_index: u32, base_vertex: u32, first_instance: u32 }
struct List { first_index: u32, first_meshlet: u32, meshlets: u32, unused: u32 }
struct DrawRecord { first: u32, first_meshlet: u32, groups: u32, instances: u32, base_vertex: u32, triangles: u32 }
struct Batch { first: u32, count: u32, draws: u32, unused: u32, records: array<DrawRecord, MAX_DRAWS> }

// As in visibility.wgsl.
struct Queues { large: u32, pieces: u32, blocks: u32, most_large: u32, most_pieces: u32, most_blocks: u32, next: u32 }

@group(0) @binding(0) var<storage, read> arguments: array<Arguments>;
@group(0) @binding(1) var<storage, read> lists: array<List>;
@group(0) @binding(2) var<storage, read_write> batch: Batch;
@group(0) @binding(3) var<storage, read_write> groups: array<u32, 3>;
@group(0) @binding(4) var<storage, read_write> queues: Queues;

fn record_of(draw: Arguments, first: u32) -> DrawRecord {
    var triangles = draw.count / 3u;
    if (KIND == MESHES) {
        var list = lists[0];
        for (var k = 1u; k < arrayLength(&lists); k += 1u) {
            if (lists[k].first_index == draw.first_index) { list = lists[k]; }
        }
        return DrawRecord(first, list.first_meshlet, list.meshlets, draw.instances, draw.base_vertex, triangles);
    }
    if (KIND == STRIPS) { triangles = max(draw.count, 2u) - 2u; }
    let groups = (triangles + TRIANGLES - 1u) / TRIANGLES;
    return DrawRecord(first, 0u, groups, draw.instances, draw.first_index, triangles);
}

@compute @workgroup_size(1)
fn prepare_batch() {
    let draws = #{DRAWS}u;
    queues.large = 0u;
    queues.pieces = 0u;
    queues.blocks = 0u;
    batch.first = queues.next;
    batch.draws = draws;
    var number = queues.next;
    for (var i = 0u; i < draws; i += 1u) {
        var record = record_of(arguments[#{FIRST_DRAW}u + i], number);
        if (record.triangles == 0u) { record.groups = 0u; }
        batch.records[i] = record;
        number += record.instances * record.groups;
    }
    batch.count = number - batch.first;
    queues.next = number;
    groups[0] = min(batch.count, ROW);
    groups[1] = (batch.count + ROW - 1u) / ROW;
    groups[2] = 1u;
}
