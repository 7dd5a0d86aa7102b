use serde::{Deserialize, Serialize};

/// One point of a [`TransferFunction`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransferPoint {
    /// Position on the window: 0 is its lower end, 1 its upper end; any finite number is allowed.
    pub s: f64,
    /// Extinction in 1/m, world space; ≥ 0.
    pub sigma_t: f64,
    /// Single-scattering albedo (linear RGB), each 0 … 1.
    pub albedo: [f64; 3],
    /// Source radiance (linear RGB), ≥ 0: the medium emits `sigma_t · emission` per metre.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub emission: [f64; 3],
    /// Roughness of the gradient surface, 0 … 1.
    #[serde(default = "TransferPoint::default_roughness")]
    pub roughness: f64,
    /// Reflectance of the gradient surface at normal incidence (F0), 0 … 1; 0 means no lobe.
    #[serde(default)]
    pub specular: f64,
}

fn is_zero(rgb: &[f64; 3]) -> bool {
    *rgb == [0.0; 3]
}

impl TransferPoint {
    fn default_roughness() -> f64 {
        0.5
    }
}

/// What a volume's values look like: piecewise linear between points, constant outside of them.
///
/// It is evaluated on s = (value − lo)/(hi − lo), after interpolation and without clamping. Where
/// points coincide in s the later one holds, so two of them make a vertical step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransferFunction {
    points: Vec<TransferPoint>,
}

/// What a [`TransferFunction`] says of one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Extinction, 1/m.
    pub sigma_t: f64,
    /// Single-scattering albedo, linear RGB.
    pub albedo: [f64; 3],
    /// Source radiance, linear RGB.
    pub emission: [f64; 3],
    /// Roughness of the gradient surface.
    pub roughness: f64,
    /// F0 of the gradient surface.
    pub specular: f64,
}

/// Why a list of points is no transfer function.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TransferFunctionError {
    /// There are no points.
    #[error("`points` is empty: a transfer function needs at least one point")]
    Empty,
    /// A point's s is smaller than the one before it.
    #[error(
        "points[{index}].s = {s} is smaller than the point before it ({previous}): sort the points by s"
    )]
    Unsorted {
        /// The later point.
        index: usize,
        /// Its s.
        s: f64,
        /// The s of the point before.
        previous: f64,
    },
    /// A number is outside of its range.
    #[error("points[{index}].{field} = {value} must be {expected}")]
    Range {
        /// Which point.
        index: usize,
        /// Which field.
        field: &'static str,
        /// What it is.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
}

/// Largest `sigma_t` that f32 kernels can multiply by a length without overflow.
const SIGMA_T_MAX: f64 = 1e30;

impl TransferFunction {
    /// Checks the points and makes a transfer function of them.
    ///
    /// # Errors
    /// If there are no points, if they are not sorted by `s`, or if a number is out of its range.
    pub fn new(points: Vec<TransferPoint>) -> Result<Self, TransferFunctionError> {
        if points.is_empty() {
            return Err(TransferFunctionError::Empty);
        }
        for (index, point) in points.iter().enumerate() {
            let check = |field, value: f64, low: f64, high: f64, expected| {
                if value >= low && value <= high {
                    Ok(())
                } else {
                    Err(TransferFunctionError::Range {
                        index,
                        field,
                        value,
                        expected,
                    })
                }
            };
            check("s", point.s, -1e30, 1e30, "a finite number")?;
            check(
                "sigma_t",
                point.sigma_t,
                0.0,
                SIGMA_T_MAX,
                "0 to 1e30 (1/m)",
            )?;
            for channel in 0..3 {
                check("albedo", point.albedo[channel], 0.0, 1.0, "0 to 1")?;
                check(
                    "emission",
                    point.emission[channel],
                    0.0,
                    SIGMA_T_MAX,
                    "0 to 1e30",
                )?;
            }
            check("roughness", point.roughness, 0.0, 1.0, "0 to 1")?;
            check("specular", point.specular, 0.0, 1.0, "0 to 1")?;
            if let Some(previous) = index.checked_sub(1).map(|i| points[i].s)
                && point.s < previous
            {
                return Err(TransferFunctionError::Unsorted {
                    index,
                    s: point.s,
                    previous,
                });
            }
        }
        Ok(Self { points })
    }

    /// The points, sorted by s.
    pub fn points(&self) -> &[TransferPoint] {
        &self.points
    }

    /// Multiplies every `sigma_t` by a factor (≥ 0).
    pub fn scaled(&self, factor: f64) -> Self {
        let points = self.points.iter().map(|p| TransferPoint {
            sigma_t: p.sigma_t * factor,
            ..*p
        });
        Self {
            points: points.collect(),
        }
    }

    /// The material at s, in f64 and from the points themselves.
    pub fn eval(&self, s: f64) -> Material {
        let after = self.points.partition_point(|point| point.s <= s);
        let (low, high) = match (after.checked_sub(1), self.points.get(after)) {
            (None, _) => (&self.points[0], &self.points[0]),
            (Some(i), None) => (&self.points[i], &self.points[i]),
            (Some(i), Some(high)) => (&self.points[i], high),
        };
        let t = if high.s > low.s {
            (s - low.s) / (high.s - low.s)
        } else {
            0.0
        };
        let lerp = |a: f64, b: f64| a + (b - a) * t;
        let lerp3 = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|c| lerp(a[c], b[c]));
        Material {
            sigma_t: lerp(low.sigma_t, high.sigma_t),
            albedo: lerp3(low.albedo, high.albedo),
            emission: lerp3(low.emission, high.emission),
            roughness: lerp(low.roughness, high.roughness),
            specular: lerp(low.specular, high.specular),
        }
    }

    /// The largest `sigma_t` for any s in [low, high], steps at either end included.
    pub fn max_sigma_t(&self, low: f64, high: f64) -> f64 {
        let first = self.points.partition_point(|point| point.s < low);
        let last = self.points.partition_point(|point| point.s <= high);
        let inside = self.points[first..last].iter().map(|point| point.sigma_t);
        inside.fold(
            self.eval(low).sigma_t.max(self.eval(high).sigma_t),
            f64::max,
        )
    }
}
