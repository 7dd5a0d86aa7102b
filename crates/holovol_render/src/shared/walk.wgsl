// Walks along a ray from cell to cell of the majorant grid, from one tentative collision to the
// next: Woodcock tracking with local majorants, Amanatides and Woo 1987 over cells.
#define_import_path holovol_render::walk

#import holovol_render::bindings::{scene, occupied, majorant_texture}

const CELL_SIZE: f32 = #{CELL_SIZE}.0;
// Below this many texels per metre along an axis, the ray never leaves its slab.
const PARALLEL: f32 = 1e-30;
const NEVER: f32 = 3e38;
// A ray with a smaller cosine to a clip plane's normal stays on its side.
const ALONG_PLANE: f32 = 1e-9;

const WALK_MOVING: u32 = 0u;
const WALK_COLLISION: u32 = 1u;
const WALK_LEFT: u32 = 2u;

// The occupied box, loaded once: walks ask for it at every step.
var<private> low_cell: vec3<i32>;
var<private> high_cell: vec3<i32>;

#if STATISTICS == 1
var<private> cells_entered: u32 = 0u;
#endif

fn walk_cells_entered() -> u32 {
#if STATISTICS == 1
    return cells_entered;
#else
    return 0u;
#endif
}

fn load_occupied() {
    low_cell = vec3<i32>(occupied.low_x, occupied.low_y, occupied.low_z);
    high_cell = vec3<i32>(occupied.high_x, occupied.high_y, occupied.high_z);
}

struct Walk {
    // Texel coordinates, and texels per metre.
    origin: vec3<f32>,
    direction: vec3<f32>,
    // Metres from the origin: where the current cell was entered, and the end of the occupied box.
    t_cell: f32,
    t_end: f32,
    // Optical depth (of the majorant) from t_cell to the next tentative collision. Measured per
    // cell, it never stalls, however small its steps are in metres.
    tau: f32,
    sigma_maj: f32,
    cell: vec3<i32>,
    // Distance to the next cell border along each axis.
    t_next: vec3<f32>,
}

fn walk_inverse(direction: vec3<f32>) -> vec3<f32> {
    return 1.0 / select(direction, vec3<f32>(PARALLEL), abs(direction) < vec3<f32>(PARALLEL));
}

fn walk_next(walk: Walk) -> vec3<f32> {
    let ahead = select(vec3<f32>(0.0), vec3<f32>(1.0), walk.direction > vec3<f32>(0.0));
    let border = CELL_SIZE * (vec3<f32>(walk.cell) + ahead);
    let t = (border - walk.origin) * walk_inverse(walk.direction);
    return select(t, vec3<f32>(NEVER), abs(walk.direction) < vec3<f32>(PARALLEL));
}

fn walk_majorant(cell: vec3<i32>) -> f32 {
    return textureLoad(majorant_texture, cell).x;
}

// Cuts a walk to what the clip planes leave.
fn walk_clip(walk: ptr<function, Walk>) {
#if CLIP_PLANES > 0
    for (var i = 0u; i < #{CLIP_PLANES}u; i += 1u) {
        let plane = scene.clip[i];
        let height = dot(plane.xyz, (*walk).origin) + plane.w;
        // Per metre along the ray: the cosine to the plane's normal.
        let rate = dot(plane.xyz, (*walk).direction);
        if abs(rate) < ALONG_PLANE {
            (*walk).t_end = select((*walk).t_end, -NEVER, height < 0.0);
        } else if rate > 0.0 {
            (*walk).t_cell = max((*walk).t_cell, -height / rate);
        } else {
            (*walk).t_end = min((*walk).t_end, -height / rate);
        }
    }
#endif
}

// Enters the occupied box; t_end <= t_cell if the ray misses it.
fn walk_start(origin: vec3<f32>, direction: vec3<f32>, t_start: f32, tau: f32) -> Walk {
    var walk: Walk;
    walk.origin = origin;
    walk.direction = direction;
    walk.tau = tau;
    let low = CELL_SIZE * vec3<f32>(low_cell);
    let high = min(CELL_SIZE * vec3<f32>(high_cell), scene.extent.xyz);
    let inverse = walk_inverse(direction);
    let t0 = (low - origin) * inverse;
    let t1 = (high - origin) * inverse;
    let parallel = abs(direction) < vec3<f32>(PARALLEL);
    let inside = origin >= low & origin <= high;
    let near = select(min(t0, t1), select(vec3<f32>(NEVER), vec3<f32>(-NEVER), inside), parallel);
    let far = select(max(t0, t1), vec3<f32>(NEVER), parallel);
    walk.t_cell = max(max(near.x, near.y), max(near.z, t_start));
    walk.t_end = min(min(far.x, far.y), far.z);
    walk_clip(&walk);
    if walk.t_end > walk.t_cell {
        let entry = origin + walk.t_cell * direction;
        walk.cell = clamp(vec3<i32>(floor(entry / CELL_SIZE)), low_cell, high_cell - 1);
        walk.t_next = walk_next(walk);
        walk.sigma_maj = walk_majorant(walk.cell);
#if STATISTICS == 1
        cells_entered += 1u;
#endif
    }
    return walk;
}

// Goes on to the next tentative collision or out of the box, by at most max_steps cells.
fn walk_advance(walk: ptr<function, Walk>, max_steps: u32) -> u32 {
    let forward = (*walk).direction > vec3<f32>(0.0);
    let step = select(vec3<i32>(-1), vec3<i32>(1), forward);
    let ahead = select(vec3<f32>(0.0), vec3<f32>(1.0), forward);
    let inverse = walk_inverse((*walk).direction);
    for (var i = 0u; i < max_steps; i += 1u) {
        let t_next = (*walk).t_next;
        let t_border = min(min(t_next.x, t_next.y), t_next.z);
        let t_exit = min(t_border, (*walk).t_end);
        let tau_exit = (*walk).sigma_maj * max(t_exit - (*walk).t_cell, 0.0);
        if (*walk).tau < tau_exit {
            return WALK_COLLISION;
        }
        (*walk).tau -= tau_exit;
        (*walk).t_cell = max(t_exit, (*walk).t_cell);
        if t_border >= (*walk).t_end {
            return WALK_LEFT;
        }
        let axis_x = t_next.x <= t_next.y & t_next.x <= t_next.z;
        let axis_y = !axis_x & t_next.y <= t_next.z;
        let axis = vec3<bool>(axis_x, axis_y, !axis_x & !axis_y);
        let cell = select((*walk).cell, (*walk).cell + step, axis);
        if any(cell < low_cell) | any(cell >= high_cell) {
            return WALK_LEFT;
        }
        (*walk).cell = cell;
        // From the border itself, not by adding a step: no drift.
        let next = (CELL_SIZE * (vec3<f32>(cell) + ahead) - (*walk).origin) * inverse;
        (*walk).t_next = select(t_next, next, axis);
        (*walk).sigma_maj = walk_majorant(cell);
#if STATISTICS == 1
        cells_entered += 1u;
#endif
    }
    return WALK_MOVING;
}

// After so many optical depths in one cell, rounding would favour some steps.
const LONG_DEPTH: f32 = 4096.0;

// Goes on by tau. In a cell of great depth, measures from nearer by; what t_cell can't express
// stays in tau, so that nothing is lost.
fn walk_deepen(walk: ptr<function, Walk>, tau: f32) {
    (*walk).tau += tau;
    if (*walk).tau > LONG_DEPTH {
        let start = (*walk).t_cell;
        (*walk).t_cell = walk_distance(*walk);
        (*walk).tau -= (*walk).sigma_maj * ((*walk).t_cell - start);
    }
}

// Metres from the origin to the tentative collision.
fn walk_distance(walk: Walk) -> f32 {
    return walk.t_cell + walk.tau / walk.sigma_maj;
}
