use super::*;
use crate::field::{ClosedForm, Radiance};
use crate::geometry::Domain;
use glam::DVec3;
use std::sync::atomic::{AtomicU64, Ordering};

/// Waves of density with relative noise that depends only on the bits of the position, like rounding.
struct Noisy {
    /// Standard deviation of the noise, relative to σ.
    noise: f64,
    /// Radians per scene unit.
    frequency: f64,
    evaluations: AtomicU64,
}

fn hash(x: Vec3) -> f64 {
    let mut h =
        x.to_array().iter().fold(7_u64, |h, v| (h ^ u64::from(v.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    h ^= h >> 29;
    h = h.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (h >> 11) as f64 * 2.0_f64.powi(-53)
}

impl RadianceField for Noisy {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(1.0)
    }
    fn evaluate(&self, positions: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
        self.evaluations.fetch_add(positions.len() as u64, Ordering::Relaxed);
        for (x, out) in positions.iter().zip(out) {
            let y = x.as_dvec3() * self.frequency;
            let smooth = 50.0 * (2.0 + y.x.sin() + (1.3 * y.y).cos() + (0.7 * y.z).sin() * 0.5);
            // Uniform on ±√3 has variance 1.
            let noise = 12.0_f64.sqrt() * (hash(*x) - 0.5);
            *out = Radiance { density: (smooth * (1.0 + self.noise * noise)) as f32, color: Vec3::splat(0.5) };
        }
    }
    fn suggested_step(&self) -> f64 {
        0.01
    }
    fn memory(&self) -> usize {
        0
    }
}

fn points(n: usize) -> Vec<Vec3> {
    (0..n)
        .map(|i| Vec3::from_array([0.8192, 0.6710, 0.5497].map(|g: f32| 1.8 * (i as f32 * g).fract() - 0.9)))
        .collect()
}

fn lattice() -> Differences {
    Differences {
        step: DVec3::splat(2.0 / 256.0),
        domain: Domain::Box(Aabb::centered_cube(1.0)),
        stencil: crate::render::Stencil::Central,
    }
}

fn steps() -> Vec<f64> {
    DifferenceErrors::steps(1e-4, 1.0 / 512.0)
}

fn errors_of(noise: f64, frequency: f64) -> DifferenceErrors {
    let field = Noisy { noise, frequency, evaluations: AtomicU64::new(0) };
    let errors = DifferenceErrors::measure(&field, &points(256), &lattice(), &steps()).unwrap();
    // Cheap: the evaluations of a few hundred rays.
    assert!(field.evaluations.into_inner() < 30_000);
    errors
}

#[test]
fn planted_noise_is_found() {
    for noise in [1e-6, 1e-5, 1e-4, 1e-3, 1e-2] {
        for frequency in [3.0, 10.0, 30.0] {
            let errors = errors_of(noise, frequency);
            let ratio = errors.noise / noise;
            assert!(ratio > 0.5 && ratio < 2.0, "{noise} at {frequency}: {ratio}");
        }
    }
}

#[test]
fn the_best_step_is_where_theory_has_it() {
    // f = sin: f‴ = −ω² f′, so μ / f′ = ω² and h* = (3 ε / μ)^⅓.
    for noise in [1e-5, 1e-4, 1e-3] {
        let frequency = 50.0;
        let errors = errors_of(noise, frequency);
        // Relative noise of σ ≈ 100 against slopes of about 50 ω · 0.64 · (1, 1.3, 0.35) along the three axes.
        // The mean of |cos| is 2/π.
        let mean = |powers: [f64; 3]| 50.0 * std::f64::consts::FRAC_2_PI * powers.iter().sum::<f64>() / 3.0;
        let slope = frequency * mean([1.0, 1.3, 0.5 * 0.7]);
        let third = frequency.powi(3) * mean([1.0, 1.3_f64.powi(3), 0.5 * 0.7_f64.powi(3)]);
        let edge = 2.0 / 256.0;
        let expected = (3.0 * noise * 107.0 / third).cbrt() / edge;
        // Among all steps: the two longer ones are beyond the limit of a derivative at a point.
        let totals = errors.steps.iter().min_by(|a, b| a.total().total_cmp(&b.total()));
        let best = totals.unwrap();
        // The grid of steps is half a decade wide, and ε is good to a factor of two.
        assert!((0.4..2.5).contains(&(best.step / expected)), "{noise}: {} instead of {expected}", best.step);
        // A third of it comes from the spread of the densities.
        let curvature = third / slope * edge * edge;
        assert!((0.6..1.6).contains(&(errors.curvature / curvature)), "{} instead of {curvature}", errors.curvature);
        // At a hundredth of the best step the noise dominates, at fifty times the waves are lost.
        assert!(errors.is_bad(best.step / 100.0, 0.01) && errors.is_bad(best.step * 50.0, 0.01));
        assert!(!errors.is_bad(best.step, 0.0));
    }
}

#[test]
fn smooth_fields_are_left_in_peace_and_bad_steps_are_not() {
    let field = ClosedForm::courtyard();
    let points = points(2000);
    let errors = DifferenceErrors::measure(&field, &points, &lattice(), &steps()).unwrap();
    assert!(errors.points > 50 && errors.noise < 1e-5, "{errors:?}");
    assert!(!errors.is_bad(1.0 / 512.0, 0.01), "the default: {errors:?}");
    assert!(errors.is_bad(10.0, 0.01), "ten lattice edges: {errors:?}");
    // Nothing to differentiate.
    assert_eq!(DifferenceErrors::measure(&field, &[Vec3::new(0.0, 0.0, 0.9)], &lattice(), &steps()), None);
    assert_eq!(DifferenceErrors::measure(&field, &[], &lattice(), &steps()), None);
}

#[test]
fn tables_of_noise_on_a_line_say_how_much() {
    const TABLES: usize = 100_000;
    let (mut levels, mut collapsed) = (Vec::new(), 0);
    for seed in 0..TABLES {
        let uniform = |i: usize| hash(Vec3::new(seed as f32, i as f32, 3.0));
        let (offset, slope) = (1.0 + 9.0 * uniform(TABLE), 2e-3 * (uniform(TABLE + 1) - 0.5));
        let table = |deviation: f64| {
            let value = |i: usize| offset + slope * i as f64 * 0.1 + deviation * 12.0_f64.sqrt() * (uniform(i) - 0.5);
            noise_level(&std::array::from_fn(value))
        };
        let found = table(1e-3).expect("noise of a thousandth is seen");
        // Values within ±√3 of the line give ‖Δᵏ‖ ≤ 2ᵏ √3: at most 3.5 after division by √(2k choose k), k ≤ 5.
        assert!(found < 3.5e-3, "{seed}: {found}");
        collapsed += usize::from(found <= 1e-4);
        levels.push(found);
        // A line without noise has only its rounding.
        assert!(table(0.0).is_none_or(|found| found < 1e-14));
        assert_eq!(noise_level(&[offset; TABLE]), None);
    }
    // Nine values now and then lie on a line by chance. Of ten million tables, 216 were ten times too quiet.
    assert!((1..=10).contains(&collapsed), "{collapsed}");
    levels.sort_by(f64::total_cmp);
    let median = levels[TABLES / 2];
    assert!((0.9e-3..1.1e-3).contains(&median), "{median}");
}

#[test]
fn a_kink_beside_one_point_is_not_the_error_of_a_step() {
    let steps = [1e-3, 3e-3, 1e-2, 3e-2];
    let measured = |truncations: [f64; 4]| truncations.map(|truncation| Sums { truncation, ..Sums::default() });
    // Squares and their roots round once each.
    let close = |found: Vec<f64>, expected: [f64; 4]| {
        found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 4.0 * f64::EPSILON * expected)
    };
    assert!(close(truncations(&steps, &measured([0.01, 0.02, 0.03, 0.05])), [0.01, 0.02, 0.03, 0.05]));
    assert!(close(truncations(&steps, &measured([0.01, 0.1, 0.03, 0.05])), [0.01, 0.03, 0.03, 0.05]));
}

#[test]
fn a_step_that_leaves_the_box_is_not_one_without_errors() {
    // Waves that the default step loses, on 16 cells. Ten edges from a point lie outside the box, where
    // nothing can be measured.
    let field = Noisy { noise: 1e-6, frequency: 1500.0, evaluations: AtomicU64::new(0) };
    let lattice = Differences { step: DVec3::splat(2.0 / 16.0), ..lattice() };
    let errors = DifferenceErrors::measure(&field, &points(512), &lattice, &steps()).unwrap();
    // (ω h)² / 6 with ω h = 1500 / 4096: 2.2 %, 3.8 % along y.
    assert!(errors.is_bad(1.0 / 512.0, 0.005), "{errors:?}");
    assert!(errors.steps.iter().all(|error| error.step < 10.0 && error.total() > 0.0), "{errors:?}");
    assert!(errors.best().step < 1.0 / 512.0, "{errors:?}");
    // If only long steps were measured, the shortest of them is the best, and is not reported as bad.
    let long = DifferenceErrors::measure(&field, &points(512), &lattice, &[0.5, 1.0, 2.0]).unwrap();
    assert_eq!(long.best().step, 0.5);
    assert!(!long.is_bad(0.5, 0.0));
}

#[test]
fn no_proposal_is_longer_than_a_derivative_can_look() {
    // Very smooth and noisy: the error falls with the step, as far as the box reaches.
    let errors = errors_of(1e-2, 0.3);
    let longer = errors.steps.iter().filter(|e| e.step > LONGEST_STEP).map(DifferenceError::total);
    assert!(longer.fold(f64::INFINITY, f64::min) < 0.5 * errors.best().total(), "the test's premise: {errors:?}");
    assert!(errors.best().step <= LONGEST_STEP, "{errors:?}");
}
