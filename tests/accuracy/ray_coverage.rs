//! Seen and empty is not never seen: ray coverage against ray tracing, in closed-form scenes.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField};
use octobayes::geometry::{Camera, Lattice, Ray};
use octobayes::monitor::Silent;
use octobayes::posterior::RayCoverage;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::RaySamples;
use octobayes::uncertainty::{Observability, UncertaintyField, merge};

const RAYS: u64 = 3_000;

fn estimation<'a>(scene: &'a ClosedForm, cameras: &'a [Camera]) -> Estimation<'a> {
    let rays = RaySettings::default().rays(RAYS).occupancy(64);
    Estimation::new(scene, cameras).rays(rays).grid(GridSettings::default().level(7))
}

/// Density along a ray, without any of the crate's marching.
fn density(scene: &ClosedForm, x: DVec3) -> f64 {
    let inside = scene.bounds().contains(x.as_vec3());
    let mut out = [Radiance::default()];
    scene.evaluate(&[x.as_vec3()], &[Vec3::X], &mut out);
    if inside { f64::from(out[0].density) } else { 0.0 }
}

#[test]
fn ray_coverage_is_that_of_ray_tracing() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [48, 48]));
    let run = estimation(&scene, &cameras).prepare().unwrap();
    let offset = run.stream().pixel_offset;
    let picks = run.stream().pixels.picks(0, RAYS);
    let lattice = Lattice::from_domain(*run.lattice().domain(), RayCoverage::LEVEL).unwrap();
    let n = lattice.cells_per_axis() as usize;
    let mut traced = vec![0_u32; n * n * n];
    // Two hundred steps per cell.
    let step = lattice.edge().min_element() / 200.0;
    for pick in picks {
        let [x, y] = pick.pixel.map(|i| f64::from(i) + offset);
        let ray: Ray = cameras[pick.camera].ray(x, y);
        let (mut t, mut depth, mut cells) = (0.5 * step, 0.0, BTreeSet::new());
        while depth < std::f64::consts::LN_2 && t < 6.0 {
            let x = ray.at(t);
            if let Some(u) = lattice.coordinates(x.as_vec3()) {
                let [i, j, k] = lattice.cell(u).0.map(|i| i as usize);
                cells.insert((i * n + j) * n + k);
                depth += step * density(&scene, x);
            }
            t += step;
        }
        cells.into_iter().for_each(|cell| traced[cell] += 1);
    }
    let mut ray_coverage = RayCoverage::new(run.lattice());
    let add = |batches: &[RaySamples], _: &RunProgress| {
        ray_coverage.add(batches);
        Ok(())
    };
    run.stream().run(Shard::whole(RAYS), RunProgress::default(), &Silent, add).unwrap();
    let counts = ray_coverage.counts();
    let (mut equal, mut close, mut blind) = (0, 0, 0);
    for (found, expected) in counts.iter().zip(&traced) {
        equal += usize::from(found == expected);
        close += usize::from(found.abs_diff(*expected) <= 1);
        blind += usize::from((*found == 0) != (*expected == 0));
    }
    eprintln!("{equal} of {} cells equal, {close} within one ray, {blind} seen by one only", counts.len());
    let share = |cells: usize| cells as f64 / counts.len() as f64;
    // The march's step, by which a ray may end early or late, is a fraction of a cell, and points miss corners that
    // a ray cuts by less than a two-hundredth.
    assert!(share(equal) > 0.97 && share(close) > 0.995 && share(blind) < 0.005);
    let seen = counts.iter().filter(|count| **count > 0).count();
    assert!(seen > counts.len() / 10 && seen < counts.len() * 9 / 10, "{seen}: seen and unseen space");
}

#[test]
fn free_air_is_not_never_seen() {
    // A ball of radius 0.6, seen from the side of positive x only.
    let (scene, cameras) = (ClosedForm::ball(), ClosedForm::half_circle(8, [48, 48]));
    let (rays, grid) = (RaySettings::default().rays(40_000).occupancy(64), GridSettings::default().level(5));
    let field = estimation(&scene, &cameras).rays(rays).grid(grid).run().unwrap().field;
    let toward: DVec3 = cameras.iter().map(|camera| camera.ray(24.0, 24.0).origin).sum::<DVec3>().normalize();
    let at = |distance: f64| (distance * toward).as_vec3();
    let observability = |x: Vec3| field.observability(x, field.query(x).uncertainty).unwrap();
    // Before the ball, on its front, inside, and behind it.
    let surface = (0..1000).map(|i| f64::from(i) / 1000.0).rfind(|d| density(&scene, d * toward) > 20.0).unwrap();
    assert_eq!(observability(at(surface + 0.15)), Observability::Free);
    assert_eq!(observability(at(surface)), Observability::Constrained);
    assert_eq!(observability(at(0.0)), Observability::Unseen);
    assert_eq!(observability(at(-0.9 * surface)), Observability::Unseen);
    assert_eq!(observability(Vec3::splat(9.0)), Observability::Unseen);
    // U alone does not tell the first from the last.
    assert_eq!(field.query(at(surface + 0.15)).uncertainty, field.query(at(0.0)).uncertainty);
}

/// Shards, groups, dense grids and files have the ray coverage of the whole run.
#[test]
fn ray_coverage_does_not_depend_on_how_the_run_was_made() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [48, 48]));
    let run = || estimation(&scene, &cameras);
    let whole = run().run().unwrap().field;
    let dense = run().grid(GridSettings::default().level(7).grid(GridKind::Dense)).run().unwrap().field;
    assert_eq!(whole.ray_coverage(), dense.ray_coverage());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.oct");
    let through_a_file = |field: &UncertaintyField| {
        field.write(&path).unwrap();
        UncertaintyField::read(&path).unwrap()
    };
    let parts = [0, 1, 2].map(|i| through_a_file(&run().shard(i, 3).run().unwrap().field));
    assert_eq!(merge(&parts).unwrap().ray_coverage(), whole.ray_coverage());
    // A finished field keeps them to a sixteenth.
    let read = through_a_file(&whole);
    for (kept, exact) in read.ray_coverage().unwrap().counts().iter().zip(whole.ray_coverage().unwrap().counts()) {
        assert!(16 * kept.abs_diff(*exact) <= *exact, "{kept} for {exact}");
    }
}
