//! Rays do not depend on how many are drawn at once, nor on how they are evaluated.

use std::sync::Mutex;

use super::*;
use crate::estimate::{GridSettings, RaySettings};
use crate::field::{ClosedForm, Differentiable, Radiance, RadianceField, RadianceJet, TrainedField, VoxelGrid};
use crate::geometry::{Aabb, Domain};
use crate::monitor::Silent;
use crate::render::GradientMethod;
use glam::Vec3;

/// A scene that is evaluated at many points at once, and records how many.
struct Wide {
    scene: VoxelGrid,
    batch: usize,
    /// Whether calls for colours count. With its own derivatives, a field evaluates colours once for all rays
    /// of a group, and no call could be larger.
    counts_colors: bool,
    /// Points of every call from the thread of the run.
    calls: Mutex<Vec<usize>>,
}

fn scene() -> VoxelGrid {
    VoxelGrid::bake(&ClosedForm::courtyard(), [64; 3], Vec3::Z)
}

impl Wide {
    fn note(&self, points: usize) {
        self.calls.lock().unwrap().push(points);
    }
}

impl RadianceField for Wide {
    fn bounds(&self) -> Aabb {
        self.scene.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        if self.counts_colors {
            self.note(positions.len());
        }
        self.scene.evaluate(positions, directions, out);
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        self.note(positions.len());
        self.scene.densities(positions, out);
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn suggested_step(&self) -> f64 {
        self.scene.suggested_step()
    }

    fn batch(&self) -> usize {
        self.batch
    }
}

impl TrainedField for Wide {}

impl Differentiable for Wide {
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        self.note(positions.len());
        self.scene.differentiable().unwrap().jets(positions, directions, out);
    }
}

/// What was handed on, however it was grouped.
fn joined(groups: impl IntoIterator<Item = Vec<RaySamples>>) -> RaySamples {
    let mut all = RaySamples::default();
    groups.into_iter().flatten().for_each(|samples| all.append(samples));
    all
}

#[test]
fn portions_of_any_size_are_the_same_rays() {
    let cameras = ClosedForm::half_circle(5, [64, 48]);
    let (field, settings) = (scene(), RaySettings::default().occupancy(32));
    let lattice = GridSettings::default().level(6).lattice(Domain::Box(field.bounds())).unwrap();
    let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
    let of = |rays_together| {
        let groups = stream.samples(&Shard::whole(2000), 0..4, rays_together, &mut None, &Silent).unwrap();
        assert_eq!(groups.iter().map(|(batches, _)| batches).sum::<u64>(), 4);
        joined(groups.into_iter().map(|(_, samples)| samples))
    };
    let whole = of(512);
    assert!(whole.rays.len() > 500, "{}", whole.rays.len());
    for rays in [1, 16, 100, 511] {
        assert!(of(rays) == whole, "{rays}");
    }
}

#[test]
#[ignore = "slow: several seconds"]
fn rays_that_ask_together_get_what_they_get_apart() {
    let cameras = ClosedForm::half_circle(5, [64, 48]);
    let rays = 100_000;
    for gradient in [GradientMethod::FiniteDifference, GradientMethod::ForwardDifference, GradientMethod::Analytic] {
        let draw = |batch: usize, shard: Shard, from: u64| {
            let counts_colors = gradient != GradientMethod::Analytic;
            let field = Wide { scene: scene(), batch, counts_colors, calls: Mutex::default() };
            let lattice = GridSettings::default().level(6).lattice(Domain::Box(field.bounds())).unwrap();
            let settings = RaySettings::default().rays(rays).gradient(gradient).occupancy(32);
            let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
            field.calls.lock().unwrap().clear();
            let mut groups = Vec::new();
            let from = RunProgress { batches: from, rays: from * BATCH, ..RunProgress::default() };
            let progress = stream.run(shard, from, &Silent, |samples, progress| {
                assert!(progress.batches <= shard.batches());
                groups.push(samples.to_vec());
                Ok(())
            });
            let calls = field.calls.lock().unwrap().clone();
            (joined(groups), progress.unwrap(), calls)
        };
        for (shard, from) in [(Shard::whole(rays), 0), (Shard::new(rays, 1, 2), 16)] {
            let (apart, progress, _) = draw(0, shard, from);
            assert!(progress.samples > 10_000, "{progress:?}");
            let (together, same, calls) = draw(1 << 13, shard, from);
            assert!(apart == together && progress == same, "{gradient:?}");
            // The last rays of a group that still go on ask about fewer.
            let [all, wide]: [usize; 2] = [0, 1 << 13].map(|least| calls.iter().filter(|n| **n >= least).sum());
            assert!(calls.len() > 20 && wide as f64 > 0.9 * all as f64, "{gradient:?}: {wide} of {all} points");
        }
    }
}

#[test]
fn what_was_cut_short_is_not_handed_on() {
    /// Requests a stop after a few evaluations of the field.
    struct Impatient<'a>(&'a Wide);
    impl Monitor for Impatient<'_> {
        fn begin(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn end(&self) {}
        fn interrupted(&self) -> bool {
            self.0.calls.lock().unwrap().len() > 200
        }
    }
    let cameras = ClosedForm::half_circle(5, [64, 48]);
    for batch in [0, 1 << 12] {
        let field = Wide { scene: scene(), batch, counts_colors: true, calls: Mutex::default() };
        let lattice = GridSettings::default().level(6).lattice(Domain::Box(field.bounds())).unwrap();
        let settings = RaySettings::default().occupancy(32);
        let stream = settings.stream(&field, &cameras, &lattice, &Silent).unwrap();
        field.calls.lock().unwrap().clear();
        let monitor = Impatient(&field);
        let mut drawn = 0;
        let result = stream.run(Shard::whole(4_000_000), RunProgress::default(), &monitor, |samples, _| {
            assert!(samples.iter().all(|batch| !batch.positions.is_empty()), "a batch that was left out");
            drawn += 1;
            Ok(())
        });
        assert!(matches!(result, Err(Error::Interrupted)), "{result:?}");
        assert!(drawn < 100, "{drawn}");
    }
}

#[test]
fn pixels_of_another_purpose_are_others() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(2, [16, 16]));
    let lattice = GridSettings::default().level(4).lattice(Domain::Box(scene.bounds())).unwrap();
    let stream = RaySettings::default().occupancy(16).stream(&scene, &cameras, &lattice, &Silent).unwrap();
    let seeds = [Purpose::Pilot, Purpose::Surface, Purpose::Group(0)].map(|purpose| stream.for_purpose(purpose));
    assert!(seeds.iter().all(|other| other.pixels.seed() != stream.pixels.seed()));
}
