// Henyey and Greenstein 1941. wo and wi point away from the scattering point; g > 0 scatters
// forward, along -wo.
#define_import_path holovol_render::phase_function

const PI: f32 = 3.14159265358979;
const INV_4PI: f32 = 0.0795774715459477;

// Two unit vectors at right angles to a third: Duff et al. 2017, "Building an Orthonormal Basis,
// Revisited".
fn basis_around(n: vec3<f32>) -> mat3x3<f32> {
    let s = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return mat3x3<f32>(
        vec3<f32>(1.0 + s * n.x * n.x * a, s * b, -s * n.x),
        vec3<f32>(b, s + n.y * n.y * a, -n.y),
        n,
    );
}

// Where the phase function peaks: forward for g > 0, else backward.
fn phase_peak(g: f32, wo: vec3<f32>) -> vec3<f32> {
    return select(wo, -wo, g >= 0.0);
}

fn phase_eval(g: f32, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    // (1 - |g|)^2 + 2 |g| (1 - cos), cos from the peak, with 1 - cos from the difference of the
    // directions: no cancellation there.
    let difference = wi - phase_peak(g, wo);
    let a = abs(g);
    let d = (1.0 - a) * (1.0 - a) + a * dot(difference, difference);
    return INV_4PI * (1.0 - a) * (1.0 + a) / (d * sqrt(d));
}

fn phase_sample(g: f32, wo: vec3<f32>, xi: vec2<f32>) -> vec3<f32> {
    // The usual inversion, solved for 1 - cos from the peak: nothing cancels there, nothing divides
    // by g.
    let a = abs(g);
    let d = (1.0 - a) + 2.0 * a * (1.0 - xi.x);
    let s = (1.0 - a) * (1.0 + a) / d;
    var one_minus_cos = (1.0 - a) * xi.x * (s + (1.0 - a)) / d;
    one_minus_cos = clamp(one_minus_cos, 0.0, 2.0);
    let cos_theta = 1.0 - one_minus_cos;
    let sin_theta = sqrt(one_minus_cos * (2.0 - one_minus_cos));
    let phi = 2.0 * PI * xi.y;
    let frame = basis_around(phase_peak(g, wo));
    return frame * vec3<f32>(sin_theta * cos(phi), sin_theta * sin(phi), cos_theta);
}
