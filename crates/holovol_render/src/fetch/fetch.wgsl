// The bare cost of looking the field up at random places: what the tracer is measured against.

#import holovol_render::bindings::{scene, dispatch, counters, accumulators}
#import holovol_render::random::{pcg3d, unit_float_triple}
#import holovol_render::field::field_at

@compute @workgroup_size(#{WORKGROUP_SIZE})
fn fetch(@builtin(global_invocation_id) invocation: vec3<u32>) {
    var sum = 0.0;
    let extent = vec3<f32>(scene.dims.xyz);
    for (var i = 0u; i < dispatch.budget; i += 1u) {
        let xi = unit_float_triple(pcg3d(vec3<u32>(invocation.x, i, dispatch.seed)));
        sum += field_at(xi * extent);
    }
    if sum == 1e30 {
        atomicAdd(&counters.lookups, 1u);
    }
}
