use holovol_volume::{TransferFunction, TransferFunctionError, TransferPoint};
use proptest::prelude::*;

fn point(s: f64, sigma_t: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo: [sigma_t / 100.0; 3],
        emission: [sigma_t * 2.0, 0.0, 0.0],
        roughness: 0.5,
        specular: 0.0,
    }
}

fn of(points: &[(f64, f64)]) -> TransferFunction {
    let points = points
        .iter()
        .map(|&(s, sigma_t)| point(s, sigma_t))
        .collect();
    TransferFunction::new(points).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn it_is_linear_between_points_and_constant_outside() {
    let ramp = of(&[(-1.0, 10.0), (1.0, 30.0), (2.0, 0.0)]);
    for (s, sigma_t) in [
        (-1e9, 10.0),
        (-1.0, 10.0),
        (0.0, 20.0),
        (0.5, 25.0),
        (1.0, 30.0),
        (1.75, 7.5),
        (2.0, 0.0),
        (f64::INFINITY, 0.0),
        (f64::NEG_INFINITY, 10.0),
    ] {
        let material = ramp.eval(s);
        assert_eq!(material.sigma_t, sigma_t, "s = {s}");
        assert!((material.albedo[2] - sigma_t / 100.0).abs() < 1e-15);
        assert_eq!(material.emission, [sigma_t * 2.0, 0.0, 0.0]);
    }
}

#[test]
fn of_coincident_points_the_later_one_holds() {
    let step = of(&[(0.0, 1.0), (0.5, 2.0), (0.5, 50.0), (0.5, 8.0), (1.0, 9.0)]);
    assert_eq!(step.eval(0.5).sigma_t, 8.0);
    assert!((step.eval(0.5f64.next_down()).sigma_t - 2.0).abs() < 1e-12);
    assert!((step.eval(0.5f64.next_up()).sigma_t - 8.0).abs() < 1e-12);
    let ends = of(&[(0.0, 1.0), (0.0, 4.0), (1.0, 5.0), (1.0, 7.0)]);
    assert_eq!(
        (ends.eval(-1.0).sigma_t, ends.eval(0.0).sigma_t),
        (1.0, 4.0)
    );
    assert_eq!((ends.eval(1.0).sigma_t, ends.eval(2.0).sigma_t), (7.0, 7.0));
}

#[test]
fn a_single_point_is_everywhere() {
    let constant = of(&[(0.3, 42.0)]);
    assert!(
        [-9.0, 0.3, 9.0]
            .iter()
            .all(|&s| constant.eval(s).sigma_t == 42.0)
    );
    assert_eq!(constant.max_sigma_t(-1.0, 1.0), 42.0);
}

#[test]
fn bad_points_are_named() {
    let error = |points: &[TransferPoint]| match TransferFunction::new(points.to_vec()) {
        Ok(_) => panic!("accepted {points:?}"),
        Err(error) => error,
    };
    assert_eq!(error(&[]), TransferFunctionError::Empty);
    let unsorted = error(&[point(0.5, 1.0), point(0.4, 1.0)]);
    assert!(
        unsorted.to_string().contains("points[1].s = 0.4"),
        "{unsorted}"
    );
    let changed = |change: &dyn Fn(&mut TransferPoint)| {
        let mut bad = point(0.0, 1.0);
        change(&mut bad);
        error(&[point(-1.0, 1.0), bad]).to_string()
    };
    for (text, part) in [
        (changed(&|p| p.s = f64::NAN), "points[1].s = NaN"),
        (changed(&|p| p.sigma_t = -1.0), "points[1].sigma_t = -1"),
        (
            changed(&|p| p.sigma_t = f64::INFINITY),
            "points[1].sigma_t = inf",
        ),
        (changed(&|p| p.albedo[1] = 1.5), "points[1].albedo = 1.5"),
        (
            changed(&|p| p.emission[2] = -0.5),
            "points[1].emission = -0.5",
        ),
        (changed(&|p| p.roughness = 2.0), "points[1].roughness = 2"),
        (changed(&|p| p.specular = -0.1), "points[1].specular = -0.1"),
    ] {
        assert!(text.contains(part), "{text} lacks {part}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Points on a coarse grid of s, so that many coincide; ends of the span on points, too.
    #[test]
    fn the_maximum_bounds_every_value(
        mut points in prop::collection::vec((0i32..8, 0.0..100.0f64), 1..8),
        span in prop::array::uniform2(-8i32..72),
    ) {
        points.sort_by_key(|point| point.0);
        let points: Vec<_> = points.iter().map(|&(s, sigma_t)| (f64::from(s), sigma_t)).collect();
        let function = of(&points);
        let [low, high] = [span[0].min(span[1]), span[0].max(span[1])].map(|s| f64::from(s) / 8.0);
        let bound = function.max_sigma_t(low, high);
        let dense = (0..=2000).map(|i| low + (high - low) * f64::from(i) / 2000.0);
        // Just beside a step its two sides differ.
        let beside = points.iter().flat_map(|p| [p.0.next_down(), p.0, p.0.next_up()]);
        let mut largest = f64::NEG_INFINITY;
        for s in dense.chain(beside).filter(|s| (low..=high).contains(s)) {
            let sigma_t = function.eval(s).sigma_t;
            prop_assert!(sigma_t <= bound * (1.0 + 1e-12), "{sigma_t} > {bound} at {s}");
            largest = largest.max(sigma_t);
        }
        // The middle ones of several coincident points are seen by no lookup.
        let inner = points.iter().filter(|p| (low..=high).contains(&p.0)).map(|p| p.1);
        prop_assert!(bound <= inner.fold(largest, f64::max) * (1.0 + 1e-12));
    }
}
