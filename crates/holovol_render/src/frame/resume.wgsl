// Turns the paths that a dispatch saved into the size of the dispatch that goes on with them,
// without asking the host.

@group(0) @binding(0) var<storage, read_write> counters: array<atomic<u32>, #{COUNTERS}>;
@group(0) @binding(1) var<storage, read_write> workgroups: array<u32, 3>;

fn count_saved() {
    let saved = min(atomicLoad(&counters[#{SAVED_PATHS}]), #{QUEUE_CAPACITY}u);
    atomicStore(&counters[#{RESUMED_PATHS}], saved);
    atomicStore(&counters[#{SAVED_PATHS}], 0u);
    let size = #{WORKGROUP_SIZE}u;
    workgroups[0] = (saved + size - 1u) / size;
    workgroups[1] = 1u;
    workgroups[2] = 1u;
}

@compute @workgroup_size(1)
fn count() {
    count_saved();
}

// The dispatch that follows runs its paths to their end.
@compute @workgroup_size(1)
fn count_last() {
    count_saved();
    atomicStore(&counters[#{UNLIMITED}], 1u);
}
