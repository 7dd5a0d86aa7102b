// Lays a volume's image over what a view has drawn: premultiplied, in the view's exposure. Its
// depth is where the ray enters the unit cube, so that the depth test hides it behind meshes in
// front, sample by sample. Meshes inside the cube have ended the paths themselves.

struct Composite {
    // Rays through the viewport's pixels in unit-cube coordinates: base + x * dx + y * dy; the
    // direction is per metre of depth.
    origin: vec4<f32>,
    origin_dx: vec4<f32>,
    origin_dy: vec4<f32>,
    direction: vec4<f32>,
    direction_dx: vec4<f32>,
    direction_dy: vec4<f32>,
    // Clip z = x * depth + y, clip w = z * depth + w.
    clip: vec4<f32>,
    // x, y: first pixel of the viewport; z, w: its size.
    viewport: vec4<f32>,
    // x, y: pixels of the image; z: its first pixel in the sums; w: vectors of a pixel, 1 or 2. One
    // is read twice, and scale allows for it.
    image: vec4<u32>,
    // x: exposure / samples; y: 1 / samples.
    scale: vec4<f32>,
}

@group(0) @binding(0) var<uniform> composite: Composite;
@group(0) @binding(1) var<storage, read> sums: array<vec4<f32>>;

// The end of 16-bit floats, of which most targets are; beyond is infinity, and then NaN.
const BRIGHTEST: f32 = 65000.0;

struct Pixel {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle over all.
    let corner = vec2<f32>(f32(index & 1u), f32(index >> 1u));
    return vec4<f32>(4.0 * corner - 1.0, 0.0, 1.0);
}

fn sum(pixel: vec2<i32>) -> vec4<f32> {
    let size = vec2<i32>(composite.image.xy);
    let inside = clamp(pixel, vec2<i32>(0), size - 1);
    let vectors = composite.image.w;
    let i = vectors * (composite.image.z + u32(inside.x + size.x * inside.y));
    return sums[i] + sums[i + vectors - 1u];
}

fn image_at(position: vec2<f32>) -> vec4<f32> {
    if all(composite.viewport.zw == vec2<f32>(composite.image.xy)) {
        return sum(vec2<i32>(position));
    }
    let corner = position * vec2<f32>(composite.image.xy) / composite.viewport.zw - 0.5;
    let base = floor(corner);
    let weight = corner - base;
    let pixel = vec2<i32>(base);
    let top = mix(sum(pixel), sum(pixel + vec2<i32>(1, 0)), weight.x);
    let bottom = mix(sum(pixel + vec2<i32>(0, 1)), sum(pixel + vec2<i32>(1, 1)), weight.x);
    return mix(top, bottom, weight.y);
}

@fragment
fn fragment(@builtin(position) fragment: vec4<f32>) -> Pixel {
    let position = fragment.xy - composite.viewport.xy;
    let origin = composite.origin + position.x * composite.origin_dx
        + position.y * composite.origin_dy;
    let direction = composite.direction + position.x * composite.direction_dx
        + position.y * composite.direction_dy;
    // Where the ray enters the cube; 0 from within. Division by 0 gives infinities of the right
    // sign, and NaN only on a face, which min and max pass over.
    let a = -origin.xyz / direction.xyz;
    let b = (1.0 - origin.xyz) / direction.xyz;
    let near = min(a, b);
    let entry = max(max(near.x, near.y), max(near.z, 0.0));
    let sums = image_at(position);
    if all(sums == vec4<f32>(0.0)) {
        discard;
    }
    let w = composite.clip.z * entry + composite.clip.w;
    let z = composite.clip.x * entry + composite.clip.y;
    var pixel: Pixel;
    pixel.depth = select(1.0, clamp(z / w, 0.0, 1.0), w > 0.0);
    let radiance = min(sums.rgb * composite.scale.x, vec3<f32>(BRIGHTEST));
    // The mean of few samples may be above 1, and would take away from what is behind.
    pixel.color = vec4<f32>(radiance, clamp(sums.a * composite.scale.y, 0.0, 1.0));
    return pixel;
}
