// Takes a frame's light into the cells' means, and means of few picks toward those around.

#import holovol_render::light_grid::cells::{LIGHT_STEPS, PICKS_OF_FRAME, cell_number}

// Picks that the mean of the 27 cells around counts for.
const AROUND: f32 = 32.0;

struct Settle {
    // Cells along x, y, z, and all.
    size: vec4<u32>,
    // Picks that what a cell knew counts for, and its mean afterwards, at most.
    kept: f32,
    most: f32,
    padding: vec2<u32>,
}

@group(0) @binding(0) var<uniform> settle_by: Settle;
@group(0) @binding(1) var<storage, read> fresh: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> settled: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read_write> smoothed: array<vec2<f32>>;

@compute @workgroup_size(64)
fn settle(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let cell = 64u * (group.x + groups.x * group.y) + local;
    if cell >= settle_by.size.w {
        return;
    }
    let found = fresh[cell];
    let before = settled[cell];
    let known = min(before.y, settle_by.kept);
    if found.x == 0u && known == before.y {
        return;
    }
    let picks = f32(min(found.x, PICKS_OF_FRAME));
    let all = known + picks;
    // Not from sums: a mean of many picks keeps what f32 can hold.
    let mean = before.x + (f32(found.y) / LIGHT_STEPS - picks * before.x) / max(all, 1e-20);
    settled[cell] = vec2<f32>(select(before.x, max(mean, 0.0), found.x > 0u), min(all, settle_by.most));
}

@compute @workgroup_size(64)
fn smooth_few(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let cell = 64u * (group.x + groups.x * group.y) + local;
    if cell >= settle_by.size.w {
        return;
    }
    let own = settled[cell];
    if own.y == 0.0 || own.y >= settle_by.most {
        smoothed[cell] = own;
        return;
    }
    let size = settle_by.size.xyz;
    let at = vec3<u32>(cell % size.x, cell / size.x % size.y, cell / (size.x * size.y));
    let low = max(at, vec3<u32>(1u)) - 1u;
    let high = min(at + 1u, size - 1u);
    var sum = vec2<f32>(0.0);
    for (var z = low.z; z <= high.z; z += 1u) {
        for (var y = low.y; y <= high.y; y += 1u) {
            for (var x = low.x; x <= high.x; x += 1u) {
                let there = settled[cell_number(vec3<u32>(x, y, z), size)];
                sum += there.y * vec2<f32>(there.x, 1.0);
            }
        }
    }
    let mean = (own.y * own.x + AROUND * sum.x / sum.y) / (own.y + AROUND);
    smoothed[cell] = vec2<f32>(mean, own.y);
}
