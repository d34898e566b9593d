//! Coarse leaves change log10 U by no more than the tolerance, at every vertex. Shards leave out nothing that the
//! whole run keeps.

use octobayes::estimate::{FieldBuilder, FieldSource, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, trace};
use octobayes::rays::{RayStream, RunProgress, Shard};
use octobayes::uncertainty::{UncertaintyField, merge};

/// The field of a shard of `stream`'s rays.
fn part(stream: &RayStream, grid: GridSettings, domain: Domain, shard: Shard) -> UncertaintyField {
    let mut builder = FieldBuilder::new(grid, domain).unwrap();
    let progress = stream.run(shard, RunProgress::default(), &Silent, |batches, _| {
        builder.add(batches);
        Ok(())
    });
    let source =
        FieldSource { source: "test".into(), progress: progress.unwrap(), shard: Some(shard), stream: Some(stream) };
    builder.finish(&source).unwrap()
}

/// Largest |Δ log10 U| over all lattice points. `dense` has one value for each.
fn largest_difference(field: &UncertaintyField, dense: &UncertaintyField) -> f64 {
    let field = field.on_dense_grid();
    let pairs = field.deviations().iter().zip(dense.deviations().iter());
    pairs.map(|(a, b)| (a / b).log10().abs()).fold(0.0, f64::max)
}

/// Checks that both have the same vertices, and the same sums but for the order in which at most `n` f64 were
/// added; and that log10 U differs by no more than follows.
fn check_equal(merged: &UncertaintyField, whole: &UncertaintyField, n: f64, what: &str) {
    assert!(merged.support() == whole.support(), "{what}: other vertices");
    let pairs = || merged.sums().unwrap().iter().zip(whole.sums().unwrap());
    for (a, b) in pairs() {
        // The entries of each term are at most its trace, and traces are not negative.
        let limit = n * f64::EPSILON * trace(&b.information);
        let off = |k: usize| (a.information[k] - b.information[k]).abs();
        assert!(a.rays == b.rays && (0..6).all(|k| off(k) <= limit), "{what}: {a:?} and {b:?}");
    }
    // H is off by less than `off` I, so every eigenvalue and every σ² is off by less than off / 2λ of itself. U is
    // stored as f32.
    let (covariance, lambda) = (whole.record().covariance, whole.record().lambda);
    let sigmas = merged.deviations().iter().zip(whole.deviations().iter());
    for ((a, b), (_, sums)) in sigmas.zip(pairs()) {
        let off = 2.0 / whole.record().rays as f64 * n * f64::EPSILON * trace(&sums.information) / (2.0 * lambda);
        let limit = match covariance {
            Covariance::Diagonal | Covariance::Trace => n * f64::EPSILON,
            Covariance::Block => off / (1.0 - f64::min(off, 0.5)),
            _ => panic!("{covariance:?} has no bound yet"),
        };
        assert!((a / b).ln().abs() <= limit + f64::from(f32::EPSILON), "{what}: {a:e} and {b:e}");
    }
}

/// Merged shards are the run over all rays, and within the tolerance of the dense grid of the same rays.
#[test]
#[ignore = "slow: several seconds"]
fn parts_joined_are_the_whole_run_at_any_tolerance() {
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(6, [64, 64]);
    let domain = Domain::Box(field.bounds());
    let rays = 8_000;
    for covariance in Covariance::ALL {
        let dense = GridSettings::default().grid(GridKind::Dense).level(5).covariance(covariance);
        let lattice = dense.lattice(domain).unwrap();
        let settings = RaySettings::default().rays(rays).occupancy(40);
        let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
        let of_all = part(&stream, dense, domain, Shard::whole(rays));
        for tolerance in [0.01, 0.1] {
            let octree = dense.grid(GridKind::Octree).tolerance(tolerance);
            let whole = part(&stream, octree, domain, Shard::whole(rays));
            let off = largest_difference(&whole, &of_all);
            assert!(off <= tolerance, "{} whole, tolerance {tolerance}: {off}", covariance.name());
            for of in [2, 4, 8] {
                let what = format!("{} in {of} parts, tolerance {tolerance}", covariance.name());
                let parts: Vec<_> =
                    (0..of).map(|index| part(&stream, octree, domain, Shard::new(rays, index, of))).collect();
                let merged = merge(&parts).unwrap();
                let off = largest_difference(&merged, &of_all);
                eprintln!("{what}: {off:.5} off the dense grid");
                assert!(off <= tolerance, "{what}: {off}");
                check_equal(&merged, &whole, rays as f64, &what);
            }
        }
    }
}

/// Runs with seeds of their own prune their octrees separately. Merged, they are still within the tolerance.
#[test]
#[ignore = "slow: several seconds"]
fn whole_runs_joined_stay_within_the_tolerance() {
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(6, [64, 64]);
    let domain = Domain::Box(field.bounds());
    for (covariance, of) in [Covariance::Diagonal, Covariance::Trace, Covariance::Block].map(|c| (c, 6)) {
        let dense = GridSettings::default().grid(GridKind::Dense).level(5).covariance(covariance);
        let fields = |grid: GridSettings| {
            let fields = (0..of).map(|seed| {
                let rays = RaySettings::default().rays(2_000).seed(seed).occupancy(40);
                let lattice = grid.lattice(domain).unwrap();
                let stream = rays.stream(&field, &cameras, &lattice, &Silent).unwrap();
                part(&stream, grid, domain, Shard::whole(rays.rays))
            });
            merge(&fields.collect::<Vec<_>>()).unwrap()
        };
        let of_all = fields(dense);
        for tolerance in [0.01, 0.1] {
            let merged = fields(dense.grid(GridKind::Octree).tolerance(tolerance));
            let off = largest_difference(&merged, &of_all);
            eprintln!("{} of {of} seeds, tolerance {tolerance}: {off:.5} off the dense grid", covariance.name());
            assert!(off <= tolerance, "{} of {of} seeds, tolerance {tolerance}: {off}", covariance.name());
        }
    }
}
