// Choice of one light direction from several candidates: resampled importance sampling (Talbot
// et al. 2005) over environment and phase function, unbiased for any number of either.
#define_import_path holovol_render::scattering

#import holovol_render::bindings::scene
#import holovol_render::environment::{LightSample, environment_eval, environment_sample, importance}
#import holovol_render::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample}
#import holovol_render::random::{pcg3d, unit_float, unit_float_pair, unit_float_triple}

struct LightChoice {
    wi: vec3<f32>,
    // f * radiance / density: multiply by throughput, albedo and transmittance.
    weight: vec3<f32>,
}

const ENVIRONMENT_CANDIDATES: u32 = #{ENVIRONMENT_CANDIDATES}u;
const SCATTER_CANDIDATES: u32 = #{SCATTER_CANDIDATES}u;

// `first` are two well-spread numbers for the first candidate, the others hang on `key`.
fn choose_light(
    g: f32,
    surface: Surface,
    wo: vec3<f32>,
    first: vec2<f32>,
    key: vec3<u32>,
) -> LightChoice {
    let all_candidates = f32(ENVIRONMENT_CANDIDATES + SCATTER_CANDIDATES);
    let environment_share = f32(ENVIRONMENT_CANDIDATES) / all_candidates;
    let scatter_share = f32(SCATTER_CANDIDATES) / all_candidates;
    var chosen_wi = vec3<f32>(0.0);
    var chosen_value = vec3<f32>(0.0);
    var chosen_target = 1.0;
    var weight_sum = 0.0;
    for (var i = 0u; i < ENVIRONMENT_CANDIDATES + SCATTER_CANDIDATES; i += 1u) {
        let bits = pcg3d(vec3<u32>(key.xy, key.z + 2u * i));
        let xi = unit_float_triple(pcg3d(vec3<u32>(key.xy, key.z + 2u * i + 1u)));
        var light: LightSample;
        if i < ENVIRONMENT_CANDIDATES {
            let index = select(bits.x, u32(first.x * 16777216.0) << 8u | bits.y >> 24u, i == 0u);
            light = environment_sample(index, select(unit_float(bits.y), first.y, i == 0u), xi);
        } else {
            let uv = select(unit_float_pair(bits.xy), first, i == 0u);
            light = environment_eval(scatter_sample(g, surface, wo, vec3<f32>(uv, xi.z)));
        }
        let value = scatter_eval(g, surface, wo, light.wi) * light.radiance;
        var pdf = environment_share * light.pdf;
#if SCATTER_CANDIDATES > 0
        pdf += scatter_share * scatter_pdf(g, surface, wo, light.wi);
#endif
        let aim = importance(value);
        let weight = select(0.0, aim / pdf, aim > 0.0 & pdf > 0.0);
        weight_sum += weight;
        if unit_float(bits.z) * weight_sum < weight {
            chosen_wi = light.wi;
            chosen_value = value;
            chosen_target = aim;
        }
    }
    return LightChoice(chosen_wi, chosen_value * (weight_sum / (chosen_target * all_candidates)));
}
