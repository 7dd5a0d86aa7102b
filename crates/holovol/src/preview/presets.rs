//! Looks to begin with, for kinds of scans.

use holovol_volume::{Histogram, TransferPoint};

use super::look::Look;
use super::studio::Scan;

/// What a scan is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Preset {
    /// By the histogram: what stands out from its surroundings.
    Automatic,
    CtBone,
    CtSkin,
    CtVessels,
    CtLung,
    Mr,
    Microscopy,
    Smoke,
}

impl Preset {
    pub(crate) const ALL: [Self; 8] = [
        Self::Automatic,
        Self::CtBone,
        Self::CtSkin,
        Self::CtVessels,
        Self::CtLung,
        Self::Mr,
        Self::Microscopy,
        Self::Smoke,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Automatic => "automatic",
            Self::CtBone => "CT, bone",
            Self::CtSkin => "CT, skin",
            Self::CtVessels => "CT, vessels",
            Self::CtLung => "CT, lung",
            Self::Mr => "MR",
            Self::Microscopy => "microscopy",
            Self::Smoke => "smoke",
        }
    }

    /// Hounsfield units, where the preset is about those.
    fn window(self) -> Option<[f64; 2]> {
        match self {
            Self::CtBone => Some([0.0, 1000.0]),
            Self::CtSkin => Some([-600.0, 400.0]),
            Self::CtVessels => Some([0.0, 700.0]),
            Self::CtLung => Some([-1000.0, 0.0]),
            _ => None,
        }
    }

    /// `edge`: s between what stands out and what is around it.
    fn points(self, edge: f64) -> Vec<TransferPoint> {
        let clear = [0.9, 0.9, 0.9];
        match self {
            Self::Automatic => {
                let albedo = [0.85, 0.82, 0.78];
                vec![
                    point(edge, 0.0, albedo, 0.03),
                    point(edge + 0.1, 0.5, albedo, 0.03),
                    point(edge.max(0.6) + 0.4, 1.0, [0.93, 0.92, 0.9], 0.03),
                ]
            }
            Self::CtBone => vec![
                point(0.15, 0.0, [0.85, 0.55, 0.45], 0.02),
                point(0.28, 0.5, [0.93, 0.82, 0.68], 0.03),
                point(0.6, 1.0, [0.96, 0.93, 0.86], 0.04),
            ],
            Self::CtSkin => vec![
                point(0.05, 0.0, [0.9, 0.68, 0.56], 0.02),
                point(0.35, 1.0, [0.9, 0.68, 0.56], 0.03),
                point(0.75, 1.0, [0.85, 0.5, 0.42], 0.03),
                point(1.0, 1.0, [0.96, 0.93, 0.86], 0.04),
            ],
            Self::CtVessels => vec![
                point(0.18, 0.0, [0.75, 0.12, 0.1], 0.04),
                point(0.3, 0.7, [0.75, 0.12, 0.1], 0.05),
                point(0.65, 1.0, [0.85, 0.3, 0.22], 0.05),
                point(0.95, 1.0, [0.96, 0.92, 0.84], 0.04),
            ],
            Self::CtLung => vec![
                point(0.05, 0.0, [0.9, 0.75, 0.72], 0.0),
                point(0.2, 0.02, [0.9, 0.75, 0.72], 0.0),
                point(0.45, 0.15, [0.85, 0.5, 0.45], 0.02),
                point(0.6, 0.0, [0.85, 0.5, 0.45], 0.02),
                point(1.1, 0.0, [0.8, 0.3, 0.25], 0.02),
                point(1.3, 0.6, [0.95, 0.9, 0.84], 0.03),
            ],
            Self::Mr => vec![
                point(0.12, 0.0, [0.8, 0.72, 0.66], 0.0),
                point(0.35, 0.12, [0.82, 0.7, 0.64], 0.02),
                point(0.7, 0.6, [0.92, 0.86, 0.8], 0.02),
                point(1.0, 1.0, [0.97, 0.95, 0.92], 0.03),
            ],
            Self::Microscopy => vec![
                point(0.1, 0.0, [0.3, 0.9, 0.5], 0.0),
                point(0.4, 0.05, [0.35, 0.95, 0.55], 0.0),
                point(1.0, 0.4, [0.85, 1.0, 0.8], 0.0),
            ],
            Self::Smoke => vec![point(0.03, 0.0, clear, 0.0), point(1.0, 0.06, clear, 0.0)],
        }
    }

    /// The one that a scan is shown by, if nothing of it has been changed.
    pub(crate) fn of(look: &Look, scan: &Scan) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| {
            let mut fresh = look.clone();
            preset.apply(&mut fresh, scan);
            fresh == *look
        })
    }

    /// Shows a scan so.
    pub(crate) fn apply(self, look: &mut Look, scan: &Scan) {
        /// Optical depth of a whole scan at 1: a surface within a voxel or two.
        const SOLID: f64 = 700.0;
        let is_smoke = scan
            .volume()
            .source_format()
            .is_some_and(|f| f.name == "OpenVDB");
        if self == Self::Automatic && is_smoke {
            return Self::Smoke.apply(look, scan);
        }
        look.window = self.window().unwrap_or(scan.grey);
        let [low, high] = look.window;
        look.points = self.points((threshold(&scan.histogram, high) - low) / (high - low));
        look.optical_depth_scale = Some(SOLID);
        look.density = 1.0;
        look.gradient_factor = match self {
            Self::Smoke | Self::Microscopy => 0.0,
            Self::CtLung => 1.0,
            _ => 3.0,
        };
        look.phase_g = if self == Self::Smoke { 0.4 } else { 0.0 };
    }
}

/// The value that parts a histogram into two classes with the greatest variance between them (Otsu
/// 1979); values above `most` count as that, so that a few very bright ones don't decide.
fn threshold(histogram: &Histogram, most: f64) -> f64 {
    let bins = || {
        let values = (0..).map(|bin| histogram.bin_centre(bin).min(most));
        values.zip(histogram.counts.iter().map(|&count| count as f64))
    };
    let total: f64 = bins().map(|(_, count)| count).sum();
    let sum: f64 = bins().map(|(value, count)| value * count).sum();
    let (mut below, mut sum_below) = (0.0, 0.0);
    let mut best = (0.0, histogram.low);
    let mut last = histogram.low;
    for (value, count) in bins().filter(|&(_, count)| count > 0.0) {
        let above = total - below;
        if below > 0.0 && value > last {
            let apart = (sum - sum_below) / above - sum_below / below;
            let between = below * above * apart * apart;
            if between > best.0 {
                best = (between, 0.5 * (last + value));
            }
        }
        below += count;
        sum_below += value * count;
        last = value;
    }
    best.1
}

fn point(s: f64, sigma_t: f64, albedo: [f64; 3], specular: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo,
        emission: [0.0; 3],
        roughness: 0.45,
        specular,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_are_valid_and_show_what_they_are_named_after() {
        for preset in Preset::ALL {
            let mut look = Look::default();
            let scan = Scan {
                grey: [5.0, 9.0],
                ..super::super::tests::blob()
            };
            preset.apply(&mut look, &scan);
            assert_eq!(Preset::of(&look, &scan), Some(preset));
            let denser = Look {
                density: 2.0,
                ..look.clone()
            };
            assert_eq!(Preset::of(&denser, &scan), None);
            let file = look.transfer_function().expect("points in order");
            let at = |value: f64| {
                let [low, high] = look.window;
                let s = (value - low) / (high - low);
                file.transfer_function.eval(s).sigma_t
            };
            // Hounsfield units of air, lung, fat, muscle, contrast, bone.
            let [air, lung, fat, muscle, contrast, bone] =
                [-1000.0, -750.0, -100.0, 50.0, 300.0, 900.0].map(at);
            match preset {
                Preset::CtBone => assert!(muscle == 0.0 && bone > 0.5),
                Preset::CtSkin => assert!(air == 0.0 && fat > 0.5 && muscle > 0.5),
                Preset::CtVessels => assert!(muscle == 0.0 && contrast > 0.5),
                Preset::CtLung => assert!(air == 0.0 && lung > 0.0 && fat == 0.0),
                _ => assert_eq!(look.window, [5.0, 9.0]),
            }
        }
    }

    #[test]
    fn what_stands_out_is_parted_from_its_surroundings() {
        // Noise about 10, a body about 100, a little metal at 3000.
        let mut counts = vec![0; 3001];
        for i in 0..20 {
            counts[i] = 50_000;
            counts[80 + 2 * i] = 4_000;
        }
        counts[3000] = 300;
        let histogram = Histogram {
            low: -0.5,
            high: 3000.5,
            counts,
        };
        let found = threshold(&histogram, 150.0);
        assert!((20.0..80.0).contains(&found), "{found}");
        let constant = Histogram {
            low: 3.0,
            high: 4.0,
            counts: vec![9],
        };
        assert_eq!(threshold(&constant, 4.0), 3.0);
    }
}
