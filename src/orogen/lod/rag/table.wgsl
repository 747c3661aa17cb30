// Places to references: a hash table. An entry is the number of a reference plus one; `place_of` knows where it stands.
// The entries of one place are one, whoever comes first, so that what is read does not depend on the order.

const MARK = 0x80000000u;

@group(1) @binding(5) var<storage, read_write> table: array<atomic<u32>>;

// A power of two, at least four entries for each triangle: never full.
fn table_size() -> u32 { return 4u << (32u - countLeadingZeros(max(state.count, GROUP) - 1u)); }

fn first_slot(place: vec2<i32>) -> u32 {
    let words = vec2<u32>(place);
    var hash = (words.x * 0x9e3779b1u) ^ (words.y * 0x85ebca77u + 0x27d4eb2fu);
    hash = (hash ^ (hash >> 15u)) * 0x2c1b3c6du;
    return (hash ^ (hash >> 13u)) & (table_size() - 1u);
}

fn stands_at(entry: u32, place: vec2<i32>) -> bool { return all(place_of((entry & ~MARK) - 1u) == place); }

// The slot of a place, which gets one if it has none.
fn slot_for(place: vec2<i32>, reference: u32) -> u32 {
    var slot = first_slot(place);
    loop {
        var entry = atomicLoad(&table[slot]);
        if (entry == 0u) {
            let tried = atomicCompareExchangeWeak(&table[slot], 0u, reference + 1u);
            if (tried.exchanged) { break; }
            entry = tried.old_value;
        }
        // 0: the exchange failed for no reason, so try again
        if (entry != 0u) {
            if (stands_at(entry, place)) { break; }
            slot = (slot + 1u) & (table_size() - 1u);
        }
    }
    return slot;
}

// The entry of a place; 0 where there is none.
fn entry_of(place: vec2<i32>) -> u32 {
    var slot = first_slot(place);
    loop {
        let entry = atomicLoad(&table[slot]);
        if (entry == 0u || stands_at(entry, place)) { return entry; }
        slot = (slot + 1u) & (table_size() - 1u);
    }
    return 0u;
}

@compute @workgroup_size(GROUP)
fn clear_table(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var slot = id.x; slot < table_size(); slot += groups.x * GROUP) { atomicStore(&table[slot], 0u); }
}
