//! Tests that reach inside the tracer; closed forms and quadrature, which share nothing with it.

use crate::environment::EnvironmentDraw;

/// A mistake put into the tracer, to see that tests notice it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Density of environment directions 5 % too large.
    EnvironmentPdf,
    /// sin θ of 1.05·θ in the environment's solid angle.
    SinTheta,
    /// g of the wrong sign in f, not in the sampler.
    SignOfG,
    /// 5 % in the Jacobian of the mirror direction.
    HalfVectorJacobian,
    /// Gradients turned like directions instead of by the inverse transpose.
    NormalTransform,
}

impl Fault {
    pub fn is(self, fault: Fault) -> bool {
        self == fault
    }

    pub fn factor(self, fault: Fault) -> f64 {
        if self == fault { 1.05 } else { 1.0 }
    }

    pub fn environment_draw(self, mut draw: EnvironmentDraw) -> EnvironmentDraw {
        draw.pdf *= self.factor(Fault::EnvironmentPdf);
        if self.is(Fault::SinTheta) {
            let theta = draw.direction.y.acos();
            draw.pdf *= theta.sin() / (1.05 * theta).sin().abs().max(1e-9);
        }
        draw
    }

    pub fn gradient(self, right: glam::DVec3, wrong: impl FnOnce() -> glam::DVec3) -> glam::DVec3 {
        if self.is(Fault::NormalTransform) {
            wrong()
        } else {
            right
        }
    }
}

mod closed_form;
mod faults;
mod invariance;
mod pictures;
mod quadrature;
mod sampling;
mod scenes;
mod significance;
mod stress;
