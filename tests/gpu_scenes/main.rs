//! The GPU path tracer against stored references, the f64 reference and closed forms.

mod closed_form;
#[path = "../support/fields.rs"]
mod fields;
#[path = "../support/gpu.rs"]
mod gpu;
mod oracle;
mod stored;

fn main() {
    gpu::run([stored::tests(), closed_form::tests(), oracle::tests()].concat());
}
