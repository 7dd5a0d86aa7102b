// Everything that kernels are bound to, once.
#define_import_path holovol_render::bindings

// Lengths in metres, directions and normals in world space unless "texel" is said: texel
// coordinates run over [0, dims], voxel i spans [i, i + 1).
struct Scene {
    // Rows of the 3x3 matrix that turns a world direction into texels per metre.
    texel_from_world_x: vec4<f32>,
    texel_from_world_y: vec4<f32>,
    texel_from_world_z: vec4<f32>,
    // xyz: voxels; w: points of the transfer function.
    dims: vec4<u32>,
    // Texel coordinates at which the unit cube ends: dims, or less where voxels were merged.
    extent: vec4<f32>,
    // xyz: cells of the majorant grid; w: largest number of scatterings.
    cells: vec4<u32>,
    // s = (texel - x) * y; z: g of the phase function; w: k * h of the surface blend, metres.
    field: vec4<f32>,
    // x, y: cosine and sine of rotation_y; z: scale; w: 1 / mean radiance, scaled; 0 if there is none.
    environment: vec4<f32>,
    // x, y: texels of the map; z: 1 / integral of importance over (u, v) * sin(theta); w: rows of
    // a band of its alias table.
    environment_size: vec4<f32>,
    // As TransferPoint.density, if there are few points.
    transfer_density: array<vec4<f32>, #{UNROLLED_POINTS}>,
    // Planes that cut the volume: what lies at dot(xyz, texel) + w < 0 is left out.
    clip: array<vec4<f32>, #{CLIP_PLANES_MAX}>,
}

// One image, and what it is seen from.
struct View {
    // Camera rays at pixel position (x, y): texel origin and texels per metre of depth, each
    // base + x * dx + y * dy, and the same direction in world space.
    ray_origin: vec4<f32>,
    ray_origin_dx: vec4<f32>,
    ray_origin_dy: vec4<f32>,
    ray_texel: vec4<f32>,
    ray_texel_dx: vec4<f32>,
    ray_texel_dy: vec4<f32>,
    ray_world: vec4<f32>,
    ray_world_dx: vec4<f32>,
    ray_world_dy: vec4<f32>,
    // xyz: the camera's axis; w: depth along it, in metres, at which ray_origin lies.
    forward: vec4<f32>,
    // x, y: pixels across and down; z: its first pixel in the accumulators; w: seed.
    image: vec4<u32>,
    // x, y: samples [start, end) of every pixel; z: of an image of few samples how many, else 0;
    // w: texels along a cell of the light grid, 0 without.
    samples: vec4<u32>,
    // Depth of opaque meshes. x, y: pixels across and down; z: first layer; w: layers, one for
    // each sample of multisampling, 0: nothing is in the way.
    mesh_depth: vec4<u32>,
}

struct Dispatch {
    // Pixels: first of the tile, and size of the tile; of every view.
    tile_origin: vec2<u32>,
    tile_size: vec2<u32>,
    seed: u32,
    // Rounds after which a path is saved for the next dispatch.
    budget: u32,
    // Paths to go on with, and room for those to be saved.
    resumed_paths: u32,
    queue_capacity: u32,
}

// Occupied cells: lowest and one past the highest, as the majorant pass found them.
struct Occupied {
    low_x: i32, low_y: i32, low_z: i32,
    high_x: i32, high_y: i32, high_z: i32,
    padding_a: i32, padding_b: i32,
}

struct Counters {
    saved_paths: atomic<u32>,
    majorant_violations: atomic<u32>,
    nonfinite_samples: atomic<u32>,
    lookups: atomic<u32>,
    cells: atomic<u32>,
    covered_samples: atomic<u32>,
    // Paths to go on with besides dispatch.resumed_paths, counted without asking the host.
    resumed_paths: atomic<u32>,
    // Not 0: paths are not saved, however long they are.
    unlimited: atomic<u32>,
}

struct TransferPoint {
    // x: s; y: sigma_t; z: change of sigma_t to the next point; w: 1 / (distance to it).
    density: vec4<f32>,
    // rgb: albedo; w: roughness.
    albedo: vec4<f32>,
    // rgb: emission; w: specular.
    emission: vec4<f32>,
}

struct SavedPath {
    words: array<vec4<u32>, #{SAVED_PATH_VECTORS}>,
}

@group(0) @binding(0) var<uniform> scene: Scene;
@group(0) @binding(1) var<uniform> dispatch: Dispatch;
#if SLICES == 1
@group(0) @binding(2) var field_texture: texture_2d_array<f32>;
#else
@group(0) @binding(2) var field_texture: texture_3d<f32>;
#endif
@group(0) @binding(3) var field_sampler: sampler;
@group(0) @binding(4) var majorant_texture: texture_storage_3d<r32float, read>;
@group(0) @binding(5) var<storage, read> occupied: Occupied;
@group(0) @binding(6) var<storage, read> transfer_points: array<TransferPoint>;
@group(0) @binding(7) var environment_texture: texture_storage_2d<rgba32float, read>;
// Per patch: threshold (bits of an f32), and column + row * 2^16 of that to go to above it.
@group(0) @binding(8) var environment_alias: texture_storage_2d<rg32uint, read>;
// Two sums per pixel: of the last FOLD_SAMPLES, and of those before.
@group(0) @binding(9) var<storage, read_write> accumulators: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> counters: Counters;
@group(0) @binding(11) var<storage, read> resumed: array<SavedPath>;
@group(0) @binding(12) var<storage, read_write> saved: array<SavedPath>;
// Per pixel, sums of: (depth, depth^2, gradient magnitude, weight), (albedo, not summed: the depth
// from which the others are measured), (normal, 0).
@group(0) @binding(13) var<storage, read_write> guides: array<vec4<f32>>;
@group(0) @binding(14) var<uniform> views: array<View, #{VIEWS_MAX}>;
// Metres along the camera's axis.
@group(0) @binding(15) var mesh_depth_texture: texture_2d_array<f32>;
// Of each view's samples those that a block of SHARE_BLOCK^2 pixels gets, of 255.
@group(0) @binding(16) var shares_texture: texture_2d_array<u32>;
