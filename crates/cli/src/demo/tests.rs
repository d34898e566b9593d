//! The demo's numbers in a known case. `tests/book.rs` runs the whole demo.

use glam::Vec3;

use super::matter::Shares;
use super::scene::{Truth, courtyard};
use super::*;
use octobayes::field::closed_form::{Primitive, Shape};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::monitor::Silent;

/// The courtyard as its own model, with a bar added behind the floor, where no camera of training sees it.
#[test]
fn a_clean_up_removes_what_is_made_up_and_keeps_what_is_seen() {
    let (scene, cameras) = courtyard(64);
    let bar = Shape::Box { center: Vec3::new(-0.89, 0.0, -0.85), half: Vec3::new(0.06, 0.3, 0.04) };
    let mut primitives = scene.primitives().to_vec();
    primitives.push(Primitive { shape: bar, ..primitives[0] });
    let model = ClosedForm::new("made up", primitives, scene.bounds(), scene.suggested_step());
    let held_out = cameras.iter().skip(4).step_by(8).copied().collect();
    let truth = Truth::new(scene, &cameras, held_out);
    let rays = RaySettings::default().rays(60_000).gradient(GradientMethod::Auto).occupancy(64);
    let grid = GridSettings::default().level(6);
    let outcome = Estimation::new(&model, &cameras).rays(rays).grid(grid).run().unwrap();
    let uncertainty = outcome.field;
    let Shown { low, threshold } = Shown::new(&uncertainty);
    let prior = uncertainty.prior().log10();
    assert!(low < threshold && threshold < prior - 0.1, "{low} {threshold} {prior}");

    let unbaked = BakedField::unbaked(&uncertainty);
    let cleaned = ThresholdedField::new(&model, &unbaked, threshold);
    let shares = Shares::measure(&cleaned, &truth, &Silent).unwrap();
    // Nothing but the bar is made up. No ray reaches it, so U is the prior all over it.
    assert!(shares.made_up_seen < 1e-3 && shares.made_up_behind > 0.005, "{shares:?}");
    assert!(shares.removed > 0.999, "{shares:?}");
    // The threshold keeps 99 % of what the cameras see. Held-out cameras see the same surfaces in other shares.
    assert!((0.98..0.998).contains(&shares.kept), "{shares:?}");

    // Nothing above the prior: nothing is removed.
    let whole = ThresholdedField::new(&model, &unbaked, prior + 1.0);
    let shares = Shares::measure(&whole, &truth, &Silent).unwrap();
    assert!(shares.kept == 1.0 && shares.removed.abs() < 1e-12, "{shares:?}");
}
