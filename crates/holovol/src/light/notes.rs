//! What users should know of an estimate, in words.

use holovol_light::estimate::Doubt;

/// How the evidence was named on the command line.
pub(super) struct Names<'a> {
    /// As `--ldr` had them, in the order of the evidence.
    pub(super) frames: Vec<&'a str>,
    pub(super) lux: Option<f64>,
    pub(super) probe: String,
}

/// Says what a doubt is about, and what its user can do.
pub(super) fn doubt(doubt: &Doubt, names: &Names) -> String {
    let name = |frame: usize| names.frames.get(frame).copied().unwrap_or("a frame");
    let lux = names.lux.unwrap_or(0.0);
    let fate = |believed: bool| match believed {
        true => "it is used, with less trust",
        false => "it is left out",
    };
    match *doubt {
        Doubt::Frame {
            frame,
            with,
            off_ev,
            differs,
            believed: false,
        } => format!(
            "{} contradicts {}: in {:.0} % of what both can tell they differ by more than half ({} in the middle); it is left out. Does it show the same view, and is its @EV right?",
            name(frame),
            name(with),
            100.0 * differs,
            brighter(off_ev)
        ),
        Doubt::Frame {
            frame,
            with,
            off_ev,
            differs,
            ..
        } => format!(
            "{} is {} than its @EV says, beside {}, and they differ in {:.0} % of what both can tell; {}. Does it show the same view, and are its @EV and --crf right?",
            name(frame),
            brighter(off_ev),
            name(with),
            100.0 * differs,
            fate(true)
        ),
        Doubt::Meter {
            off_ev,
            spreads,
            believed,
        } => format!(
            "--lux {lux} is {} than the picture and its lights let expect ({spreads:.0} times what is likely); {}. It is lux over the luminance (cd/m²) at which the first frame clips",
            brighter(off_ev),
            fate(believed)
        ),
        Doubt::UnseeingMeter => format!(
            "--lux {lux}: the picture shows next to no light from above that it could be compared with; it is left out"
        ),
        Doubt::Probe {
            off_ev,
            spreads,
            believed,
            ..
        } => format!(
            "{} is {} than the picture and its lights let expect ({spreads:.0} times what is likely); {}. Its unit is that of the first frame, in which 1 clips",
            names.probe,
            brighter(off_ev),
            fate(believed)
        ),
        Doubt::Colourless { sun_ev } => format!(
            "{} has no colours, so that a sun is not told from a lamp; if it shows one, there is about {sun_ev:.1} EV more light",
            name(0)
        ),
        Doubt::Black { .. } => format!(
            "{} is black, or nearly so: next to nothing can be told of its light; expose more",
            name(0)
        ),
        _ => format!("{doubt:?}"),
    }
}

fn brighter(ev: f64) -> String {
    let side = if ev < 0.0 { "darker" } else { "brighter" };
    format!("{:.1} EV {side}", ev.abs())
}
