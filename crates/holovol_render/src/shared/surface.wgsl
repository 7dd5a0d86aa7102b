// Phase function blended with a surface where the field has a strong gradient: Kroes et al. 2012,
// "Exposure Render", with a GGX lobe. DESIGN: f = (1 - P) HG + P [diffuse + specular].
#define_import_path holovol_render::surface

#import holovol_render::phase_function::{phase_eval, phase_sample, basis_around, PI}

struct Surface {
    // Unit normal on the side of wo; P: probability of the surface over the phase function.
    normal: vec3<f32>,
    probability: f32,
    // F0; 0: no lobe. alpha of GGX.
    specular: f32,
    alpha: f32,
}

fn fresnel(specular: f32, cosine: f32) -> f32 {
    if specular == 0.0 {
        return 0.0;
    }
    let m = clamp(1.0 - cosine, 0.0, 1.0);
    let m2 = m * m;
    return specular + (1.0 - specular) * m2 * m2 * m;
}

fn ggx_density(alpha: f32, normal: vec3<f32>, h: vec3<f32>) -> f32 {
    let a2 = alpha * alpha;
    // 1 - n_h^2 (1 - a2), with the sine squared from a cross product: 1 - n_h^2 has lost all of its
    // digits where a smooth surface's peak lies.
    let across = cross(normal, h);
    let n_h = dot(normal, h);
    let d = dot(across, across) + n_h * n_h * a2;
    return a2 / (PI * d * d);
}

// Height-correlated Smith G / (4 n_o n_i): Heitz 2014.
fn ggx_visibility(alpha: f32, n_o: f32, n_i: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = n_i * sqrt(a2 + (1.0 - a2) * n_o * n_o) + n_o * sqrt(a2 + (1.0 - a2) * n_i * n_i);
    return 0.5 / max(d, 1e-12);
}

fn scatter_eval(g: f32, surface: Surface, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    var f = phase_eval(g, wo, wi);
#if SURFACE == 1
    f *= 1.0 - surface.probability;
    let n_i = dot(surface.normal, wi);
    if n_i > 0.0 && surface.probability > 0.0 {
        let n_o = max(dot(surface.normal, wo), 0.0);
        var lobe = (1.0 - fresnel(surface.specular, n_o)) * n_i / PI;
        if surface.specular > 0.0 {
            let h = normalize(wo + wi);
            let d = ggx_density(surface.alpha, surface.normal, h);
            lobe += d * ggx_visibility(surface.alpha, n_o, n_i) * n_i
                * fresnel(surface.specular, dot(h, wo));
        }
        f += surface.probability * lobe;
    }
#endif
    return f;
}

#if SURFACE == 1
fn specular_probability(surface: Surface, n_o: f32) -> f32 {
    return select(0.0, clamp(fresnel(surface.specular, n_o), 0.1, 0.9), surface.specular > 0.0);
}
#endif

// Density over solid angle of scatter_sample.
fn scatter_pdf(g: f32, surface: Surface, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    var pdf = phase_eval(g, wo, wi);
#if SURFACE == 1
    pdf *= 1.0 - surface.probability;
    let n_i = dot(surface.normal, wi);
    let n_o = max(dot(surface.normal, wo), 0.0);
    if surface.probability > 0.0 {
        let specular = specular_probability(surface, n_o);
        var lobe = (1.0 - specular) * max(n_i, 0.0) / PI;
        // No normal below the surface is drawn; wi = -wo has none.
        let half = wo + wi;
        if specular > 0.0 && dot(surface.normal, half) > 0.0 {
            let h = normalize(half);
            let a2 = surface.alpha * surface.alpha;
            // G1 D / (4 n_o): visible normals, reflected.
            let root = sqrt(a2 + (1.0 - a2) * n_o * n_o);
            lobe += specular * ggx_density(surface.alpha, surface.normal, h)
                * 0.5 / max(n_o + root, 1e-12);
        }
        pdf += surface.probability * lobe;
    }
#endif
    return pdf;
}

// Draws wi; xi.z chooses between phase function, diffuse and specular lobe.
fn scatter_sample(g: f32, surface: Surface, wo: vec3<f32>, xi: vec3<f32>) -> vec3<f32> {
#if SURFACE == 1
    if xi.z < surface.probability {
        let frame = basis_around(surface.normal);
        let n_o = max(dot(surface.normal, wo), 0.0);
        let phi = 2.0 * PI * xi.y;
        if xi.z >= surface.probability * specular_probability(surface, n_o) {
            let radius = sqrt(xi.x);
            let z = sqrt(max(1.0 - xi.x, 0.0));
            return normalize(frame * vec3<f32>(radius * cos(phi), radius * sin(phi), z));
        }
        // Visible normals by a spherical cap: Dupuy and Benyoub 2023.
        let wo_local = transpose(frame) * wo;
        let wo_stretched = normalize(vec3<f32>(surface.alpha * wo_local.xy, max(wo_local.z, 0.0)));
        let z = (1.0 - xi.x) * (1.0 + wo_stretched.z) - wo_stretched.z;
        let sin_theta = sqrt(clamp(1.0 - z * z, 0.0, 1.0));
        let cap = vec3<f32>(sin_theta * cos(phi), sin_theta * sin(phi), z) + wo_stretched;
        let h = normalize(frame * normalize(vec3<f32>(surface.alpha * cap.xy, max(cap.z, 1e-7))));
        return normalize(2.0 * dot(wo, h) * h - wo);
    }
#endif
    return phase_sample(g, wo, xi.xy);
}
