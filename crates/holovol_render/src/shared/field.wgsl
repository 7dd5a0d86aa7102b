// The scalar field: trilinear between voxel centres, clamped at the border.
#define_import_path holovol_render::field

#import holovol_render::bindings::{scene, field_texture, field_sampler}

// s at a texel coordinate.
fn field_at(texel: vec3<f32>) -> f32 {
#if HARDWARE_INTERPOLATION == 1
    let unit_cube = texel / vec3<f32>(scene.dims.xyz);
    let value = textureSampleLevel(field_texture, field_sampler, unit_cube, 0.0).x;
#else
#if SLICES == 1
    let corner = texel - 0.5;
    let base = floor(corner);
    let weight = corner - base;
    // The middle between four texels: whatever the texture unit rounds, it takes those four.
    let middle = (base.xy + 1.0) / vec2<f32>(scene.dims.xy);
    let last_layer = i32(scene.dims.z) - 1;
    let layer = i32(base.z);
    let front = textureGather(0, field_texture, field_sampler, middle, clamp(layer, 0, last_layer));
    let back = textureGather(0, field_texture, field_sampler, middle, clamp(layer + 1, 0, last_layer));
    // Gathered counter-clockwise from the lower left: (0,1), (1,1), (1,0), (0,0).
    let low_x = vec4<f32>(front.w, front.x, back.w, back.x);
    let along_x = low_x + (vec4<f32>(front.z, front.y, back.z, back.y) - low_x) * weight.x;
    let along_y = along_x.xz + (along_x.yw - along_x.xz) * weight.y;
    let value = along_y.x + (along_y.y - along_y.x) * weight.z;
#else
    let corner = texel - 0.5;
    let base = floor(corner);
    let weight = corner - base;
    let last = vec3<i32>(scene.dims.xyz) - 1;
    let low = clamp(vec3<i32>(base), vec3<i32>(0), last);
    let high = clamp(vec3<i32>(base) + 1, vec3<i32>(0), last);
    let v000 = textureLoad(field_texture, low, 0).x;
    let v100 = textureLoad(field_texture, vec3<i32>(high.x, low.yz), 0).x;
    let v010 = textureLoad(field_texture, vec3<i32>(low.x, high.y, low.z), 0).x;
    let v110 = textureLoad(field_texture, vec3<i32>(high.xy, low.z), 0).x;
    let v001 = textureLoad(field_texture, vec3<i32>(low.xy, high.z), 0).x;
    let v101 = textureLoad(field_texture, vec3<i32>(high.x, low.y, high.z), 0).x;
    let v011 = textureLoad(field_texture, vec3<i32>(low.x, high.yz), 0).x;
    let v111 = textureLoad(field_texture, high, 0).x;
    // a + (b - a) w is exact where a = b: a constant cell stays within its range.
    let low_x = vec4<f32>(v000, v010, v001, v011);
    let along_x = low_x + (vec4<f32>(v100, v110, v101, v111) - low_x) * weight.x;
    let along_y = along_x.xz + (along_x.yw - along_x.xz) * weight.y;
    let value = along_y.x + (along_y.y - along_y.x) * weight.z;
#endif
#endif
    return (value - scene.field.x) * scene.field.y;
}

// World-space gradient of s, 1/m: central differences at one voxel along each volume axis.
fn field_gradient(texel: vec3<f32>) -> vec3<f32> {
    let d = 0.5 * vec3<f32>(
        field_at(texel + vec3<f32>(1.0, 0.0, 0.0)) - field_at(texel - vec3<f32>(1.0, 0.0, 0.0)),
        field_at(texel + vec3<f32>(0.0, 1.0, 0.0)) - field_at(texel - vec3<f32>(0.0, 1.0, 0.0)),
        field_at(texel + vec3<f32>(0.0, 0.0, 1.0)) - field_at(texel - vec3<f32>(0.0, 0.0, 1.0)),
    );
    return d.x * scene.texel_from_world_x.xyz
        + d.y * scene.texel_from_world_y.xyz
        + d.z * scene.texel_from_world_z.xyz;
}
