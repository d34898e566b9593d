//! The demo's claims: what its numbers say of a known case, and what they are on the real demo.

use glam::Vec3;

use super::matter::{Matter, Shares};
use super::scene::{Truth, courtyard};
use super::*;
use crate::field::ClosedForm;
use crate::field::closed_form::{Primitive, Shape};
use crate::geometry::Camera;
use crate::monitor::Silent;

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
    let source = "made up".to_owned();
    let named: Vec<(String, Camera)> = cameras.iter().map(|c| (String::new(), *c)).collect();
    let field = Box::new(model.clone());
    let subject = DemoScene { field, cameras: named, source, truth: None };
    let rays = RaySettings::default().rays(60_000).gradient(GradientMethod::Auto).occupancy(64);
    let grid = GridSettings::default().level(6);
    let outcome = Estimation::new(&model, &cameras).rays(rays).grid(grid).run().unwrap();
    let uncertainty = outcome.field;
    let Shown { low, threshold } = Shown::new(&subject, &uncertainty, &Silent).unwrap();
    let prior = uncertainty.prior().log10();
    assert!(low < threshold && threshold < prior - 0.1, "{low} {threshold} {prior}");

    let cleaned = ThresholdedField::new(&model, &uncertainty, threshold);
    let shares = Shares::measure(&cleaned, &truth, &Silent).unwrap();
    // Nothing but the bar is made up. No ray reaches it, so U is the prior all over it.
    assert!(shares.made_up_seen < 1e-3 && shares.made_up_behind > 0.005, "{shares:?}");
    assert!(shares.removed > 0.999, "{shares:?}");
    // The threshold keeps 99 % of what the cameras see. Held-out cameras see the same surfaces in other shares.
    assert!((0.98..0.998).contains(&shares.kept), "{shares:?}");

    // Nothing above the prior: nothing is removed.
    let whole = ThresholdedField::new(&model, &uncertainty, prior + 1.0);
    let shares = Shares::measure(&whole, &truth, &Silent).unwrap();
    assert!(shares.kept == 1.0 && shares.removed.abs() < 1e-12, "{shares:?}");
    let seen = Matter::seen(&model, &cameras, &uncertainty, &Silent).unwrap();
    let quantiles = [0.0, 0.3, 0.9, 1.0].map(|share| seen.quantile(share).unwrap());
    assert!(quantiles.is_sorted() && quantiles[3] <= prior + 1e-6, "{quantiles:?}");
    let nothing = ClosedForm::new("nothing", Vec::new(), model.bounds(), 0.01);
    assert!(Matter::seen(&nothing, &cameras, &uncertainty, &Silent).unwrap().quantile(0.5).is_none());
}

#[test]
#[ignore = "slow: trains the demo's model"]
fn the_demo_is_what_it_promises() {
    let model = model::train(0, &Silent).unwrap();
    let psnr = model.held_out.as_ref().unwrap().psnr;
    let subject = DemoScene::trained(model);
    let args = Args { output: PathBuf::new(), scene: None, level: 7, rays: 200_000 };
    let [octree, dense] = args.both_fields(&subject, &Silent).unwrap();
    let vertices = octree.deviations().len() as f64 / dense.deviations().len() as f64;
    let Shown { threshold, .. } = Shown::new(&subject, &octree, &Silent).unwrap();
    let model = ThresholdedField::new(subject.field.as_ref(), &octree, threshold);
    let shares = Shares::measure(&model, subject.truth.as_ref().unwrap(), &Silent).unwrap();
    // Seeds 0 to 3 of the same settings gave 42.7 to 43.9 dB, 11.1 to 11.7 % of the vertices, at most 0.02 % made up on
    // the seen side and 13.4 to 17.3 % behind, of which 99.2 to 99.6 % were removed, and 99.0 % kept. Bounds lie
    // three ranges of these four beyond them. That floating-point libraries differ is like another seed.
    let figures = format!("{psnr} dB, {vertices} of the vertices, threshold {threshold}, {shares:?}");
    assert!(psnr > 39.0, "{figures}");
    assert!(vertices < 0.135, "{figures}");
    assert!(shares.made_up_seen < 1e-3 && shares.made_up_behind > 0.017, "{figures}");
    assert!(shares.removed > 0.98 && shares.kept > 0.98, "{figures}");
}
