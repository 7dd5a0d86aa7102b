// Majorants of 8^3 cells: first the range of values that interpolation can meet in each cell,
// once per volume, then the largest extinction over that range, once per transfer function.

@group(0) @binding(0) var<uniform> params: Params;
#if SLICES == 1
@group(0) @binding(1) var field_texture: texture_2d_array<f32>;
#else
@group(0) @binding(1) var field_texture: texture_3d<f32>;
#endif
@group(0) @binding(2) var<storage, read_write> cell_ranges: array<vec2<f32>>;
@group(0) @binding(3) var majorant_texture: texture_storage_3d<r32float, write>;
@group(0) @binding(4) var<storage, read> points: array<vec2<f32>>;
// Row k, entry i: the largest sigma_t of points i to i + 2^k - 1.
@group(0) @binding(5) var<storage, read> range_maximum: array<f32>;
@group(0) @binding(6) var<storage, read_write> occupied: array<atomic<i32>, 8>;

struct Params {
    dims: vec4<u32>,
    // w: points of the transfer function.
    cells: vec4<u32>,
    // s = (texel - x) * y.
    field: vec4<f32>,
}

const CELL_SIZE: i32 = #{CELL_SIZE};
// Interpolation in f32, or with hardware's 8-bit weights, may leave a cell's range by rounding; a
// vertical step of the transfer function could lie just there. A constant cell stays constant.
const RANGE_MARGIN: f32 = 1e-6;
const MAJORANT_MARGIN: f32 = 1.000001;
// Of the larger end of a segment: by so much two ways to interpolate along it may differ.
const SEGMENT_MARGIN: f32 = 9.5e-7;

fn cell_index(cell: vec3<u32>) -> u32 {
    return cell.x + params.cells.x * (cell.y + params.cells.y * cell.z);
}

fn field_texel(position: vec3<i32>) -> f32 {
#if SLICES == 1
    return textureLoad(field_texture, position.xy, position.z, 0).x;
#else
    return textureLoad(field_texture, position, 0).x;
#endif
}

@compute @workgroup_size(4, 4, 4)
fn cell_range(@builtin(global_invocation_id) cell: vec3<u32>) {
    if any(cell >= params.cells.xyz) {
        return;
    }
    let last = vec3<i32>(params.dims.xyz) - 1;
    let low = max(CELL_SIZE * vec3<i32>(cell) - 1, vec3<i32>(0));
    let high = min(CELL_SIZE * vec3<i32>(cell) + CELL_SIZE, last);
    var lowest = field_texel(low);
    var highest = lowest;
    for (var z = low.z; z <= high.z; z += 1) {
        for (var y = low.y; y <= high.y; y += 1) {
            for (var x = low.x; x <= high.x; x += 1) {
                let value = field_texel(vec3<i32>(x, y, z));
                lowest = min(lowest, value);
                highest = max(highest, value);
            }
        }
    }
    cell_ranges[cell_index(cell)] = vec2<f32>(lowest, highest);
}

// How many points have s < limit, or s <= limit.
fn points_below(limit: f32, or_at: bool) -> u32 {
    var low = 0u;
    var high = params.cells.w;
    while low < high {
        let middle = (low + high) / 2u;
        let s = points[middle].x;
        if s < limit || (or_at && s == limit) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// x: sigma_t at s; y: the larger end of the segment that s lies within, 0 at a point.
fn sigma_t_at(s: f32) -> vec2<f32> {
    let after = points_below(s, true);
    let low = points[max(after, 1u) - 1u];
    let high = points[min(after, params.cells.w - 1u)];
    let t = select(0.0, clamp((s - low.x) / (high.x - low.x), 0.0, 1.0), high.x > low.x);
    return vec2<f32>(low.y + (high.y - low.y) * t, select(0.0, max(low.y, high.y), t > 0.0));
}

// Bound of sigma_t over [low, high]: taken at the ends, or at a point between them.
fn bound_sigma_t(low: f32, high: f32) -> f32 {
    let ends = max(sigma_t_at(low), sigma_t_at(high));
    var largest = ends.x;
    let first = points_below(low, false);
    let end = points_below(high, true);
    if end > first {
        let k = firstLeadingBit(end - first);
        let row = k * params.cells.w;
        largest = max(largest, range_maximum[row + first]);
        largest = max(largest, range_maximum[row + end - (1u << k)]);
    }
    return MAJORANT_MARGIN * largest + SEGMENT_MARGIN * ends.y;
}

@compute @workgroup_size(4, 4, 4)
fn majorant(@builtin(global_invocation_id) cell: vec3<u32>) {
    if any(cell >= params.cells.xyz) {
        return;
    }
    let ends = (cell_ranges[cell_index(cell)] - params.field.x) * params.field.y;
    let low = min(ends.x, ends.y);
    let high = max(ends.x, ends.y);
    let scale = max(1.0, max(abs(low), abs(high)));
    let margin = select(RANGE_MARGIN * scale, 0.0, low == high);
    let sigma_maj = bound_sigma_t(low - margin, high + margin);
    textureStore(majorant_texture, cell, vec4<f32>(sigma_maj));
    if sigma_maj > 0.0 {
        for (var axis = 0u; axis < 3u; axis += 1u) {
            atomicMin(&occupied[axis], i32(cell[axis]));
            atomicMax(&occupied[3u + axis], i32(cell[axis]) + 1);
        }
    }
}
