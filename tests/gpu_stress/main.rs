//! The GPU path tracer at the ends of what numbers can do: each test states what it expects.

mod data;
#[path = "../support/fields.rs"]
mod fields;
#[path = "../support/gpu.rs"]
mod gpu;
mod matter;
mod space;
mod work;

fn main() {
    gpu::run(
        [
            matter::tests(),
            data::tests(),
            space::tests(),
            work::tests(),
        ]
        .concat(),
    );
}
