//! Runs of splats: the same stages behind the samples, other rays in front of them.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, Quat, Vec3};

use octobayes::Error;
use octobayes::estimate::{
    Checkpoint, CoverageCheck, Estimation, FieldBuilder, FieldSource, GridKind, GridSettings, RaySettings,
};
use octobayes::geometry::{Camera, Domain, Lattice, Mask};
use octobayes::monitor::{Monitor, Silent};
use octobayes::posterior::{Criteria, Criterion, VertexSums};
use octobayes::rays::{Pixels, RayStream, RunProgress, Shard};
use octobayes::render::{GradientMethod, RaySamples};
use octobayes::uncertainty::{BakedField, Observability, UncertaintyField, is_certain, merge};
use octobayes_splats::{RenderMode, SplatRenderer, Splats, seen_domain};

/// A monitor that interrupts after a number of rays.
struct After(AtomicU64);

impl Monitor for After {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, rays: u64) {
        self.0.fetch_sub(rays.min(self.0.load(Ordering::Relaxed)), Ordering::Relaxed);
    }
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        self.0.load(Ordering::Relaxed) == 0
    }
}

/// A shell of splats of several colours, and one far away.
fn shell() -> Splats {
    let count = 1500;
    let (mut means, mut scales, mut rotations, mut opacities, mut sh) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for i in 0..count {
        // Fibonacci's lattice on the sphere.
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        let normal = Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
        means.push(0.8 * normal * if i == 0 { 100.0 } else { 1.0 });
        scales.push(Vec3::new(-3.2, -3.4, -4.6));
        rotations.push(Quat::from_rotation_arc(Vec3::Z, normal));
        opacities.push(1.0 + (i % 5) as f32);
        for k in 0..12 {
            sh.push(((i * 7 + k * 5) % 11) as f32 / 5.0 - 1.0);
        }
    }
    Splats::new(means, scales, rotations, opacities, sh, 1, RenderMode::Classic).unwrap()
}

fn lattice() -> Lattice {
    grid().lattice(domain()).unwrap()
}

fn cameras() -> Vec<Camera> {
    let eye = |i: u32| {
        let (sin, cos) = (f64::from(i) * 0.7).sin_cos();
        DVec3::new(2.5 * cos, 2.5 * sin, 0.6)
    };
    // Of two sizes, so that turns are uneven.
    let camera = |i: u32| Camera::look_at(eye(i), DVec3::ZERO, DVec3::Z, 0.8, [48, if i == 1 { 24 } else { 40 }]);
    (0..4).map(camera).collect()
}

fn domain() -> Domain {
    Domain::Box(octobayes::geometry::Aabb::centered_cube(1.0))
}

fn settings(rays: u64) -> RaySettings {
    RaySettings::default().rays(rays).background(Vec3::ZERO)
}

fn grid() -> GridSettings {
    GridSettings::default().level(5)
}

fn run(splats: &Splats, cameras: &[Camera], rays: u64) -> UncertaintyField {
    let run = Estimation::new(splats, cameras).domain(domain()).rays(settings(rays)).grid(grid());
    run.run().unwrap().field
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (splats, cameras) = (shell(), cameras());
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&splats, &cameras, 5000))
    };
    let [one, two, many] = [1, 2, 7].map(on);
    assert!(one == two && one == many);
    assert!(one.surface().len() > 1000, "{} points on surfaces", one.surface().len());
}

/// All samples of a run.
fn drawn(stream: &RayStream, shard: Shard) -> Vec<RaySamples> {
    let mut all = Vec::new();
    stream
        .run(shard, RunProgress::default(), &Silent, |batches, _| {
            all.extend_from_slice(batches);
            Ok(())
        })
        .unwrap();
    all
}

fn sums(batches: &[RaySamples]) -> Vec<VertexSums> {
    let mut builder = FieldBuilder::new(grid().grid(GridKind::Dense), domain()).unwrap();
    builder.add(batches);
    let source =
        FieldSource { progress: RunProgress { rays: 5000, ..RunProgress::default() }, ..FieldSource::default() };
    builder.finish(&source).unwrap().sums().unwrap().to_vec()
}

#[test]
fn rays_are_those_of_cameras_in_turn_in_another_order() {
    let (splats, cameras) = (shell(), cameras());
    let stream = settings(5000).stream(&splats, &cameras, &lattice(), &Silent).unwrap();
    // A mask is part of it.
    let mask = Mask::new(cameras[2].resolution, |x, y| x > 10 && y < 33);
    let stream = stream.with_masks(&[None, None, Some(mask), None]).unwrap();
    let batches = drawn(&stream, Shard::whole(5000));
    let ray = |camera: usize, [x, y]: [u32; 2]| cameras[camera].ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let key = |ray: &octobayes::geometry::Ray| [ray.origin, ray.direction].map(|v| v.to_array().map(f64::to_bits));
    let mut expected: Vec<_> =
        stream.pixels.picks(0, 5000).iter().map(|pick| key(&ray(pick.camera, pick.pixel))).collect();
    let mut found: Vec<_> = batches.iter().flat_map(|batch| &batch.sight).map(|segment| key(&segment.ray)).collect();
    expected.sort_unstable();
    found.sort_unstable();
    assert!(expected == found && found.len() == 5000);
    // Indices rise, and a camera's rays stay together.
    let eyes: Vec<_> = batches.iter().flat_map(|batch| &batch.sight).map(|s| s.ray.origin.to_array()).collect();
    assert_eq!(eyes.chunk_by(|a, b| a == b).count(), 4);
    let indices: Vec<u64> = batches.iter().flat_map(|batch| batch.rays.iter().copied()).collect();
    assert!(indices.is_sorted_by(|a, b| a < b) && indices.len() > 2000);

    // The same rays in the order of turns have the same sums.
    let mut in_turn: Vec<(usize, RaySamples)> = Vec::new();
    for batch in &batches {
        for (ray, samples) in batch.iter() {
            let mut alone = RaySamples::default();
            samples.for_each(|i| alone.push(0, batch.sample(i)));
            in_turn.push((mix_of(ray), alone));
        }
    }
    in_turn.sort_by_key(|(key, _)| *key);
    let mut shuffled = RaySamples::default();
    for (index, (_, ray)) in in_turn.iter().enumerate() {
        (0..ray.positions.len()).for_each(|i| shuffled.push(index as u64, ray.sample(i)));
    }
    let (a, b) = (sums(&batches), sums(&[shuffled]));
    let mut touched = 0;
    for (a, b) in a.iter().zip(&b) {
        let scale = a.information[0] + a.information[3] + a.information[5];
        touched += usize::from(scale > 0.0);
        for k in 0..6 {
            assert!((a.information[k] - b.information[k]).abs() <= 1e-9 * scale, "{a:?} against {b:?}");
        }
    }
    assert!(touched > 1000, "{touched}");
}

/// Another order.
fn mix_of(ray: u64) -> usize {
    octobayes::io::mix(ray) as usize
}

#[test]
fn shards_have_all_rays_once_and_merge_to_the_whole() {
    let (splats, cameras) = (shell(), cameras());
    let stream = settings(5000).stream(&splats, &cameras, &lattice(), &Silent).unwrap();
    let whole: Vec<RaySamples> = drawn(&stream, Shard::whole(5000));
    let mut parts: Vec<RaySamples> = (0..3).flat_map(|i| drawn(&stream, Shard::new(5000, i, 3))).collect();
    parts.sort_by_key(|batch| batch.rays.first().copied());
    // Batches are the same, bit for bit.
    assert!(whole == parts);

    let shard = |i| {
        let run = Estimation::new(&splats, &cameras).domain(domain()).rays(settings(5000)).grid(grid());
        run.shard(i, 3).run().unwrap().field
    };
    let merged = merge(&(0..3).map(shard).collect::<Vec<_>>()).unwrap();
    let compared = octobayes::uncertainty::compare(&merged, &run(&splats, &cameras, 5000), 5000, 1).unwrap();
    assert!(compared.in_box.clone().unwrap().max < 1e-5, "{compared:?}");
}

#[test]
fn a_run_through_every_pixel_is_drawn_camera_by_camera() {
    let (splats, cameras) = (shell(), cameras());
    let every = settings(1).pixels(Pixels::Every);
    let total: u64 = cameras.iter().map(Camera::pixels).sum();
    let start = || Estimation::new(&splats, &cameras).domain(domain()).rays(every).grid(grid());
    let whole = start().run().unwrap();
    assert_eq!(whole.progress.rays, total);
    let merged = merge(&[0, 1].map(|i| start().shard(i, 2).run().unwrap().field)).unwrap();
    assert_eq!(merged.record().rays, total);
    let compared = octobayes::uncertainty::compare(&merged, &whole.field, 5000, 1).unwrap();
    assert!(compared.in_box.clone().unwrap().max < 1e-5, "{compared:?}");
}

#[test]
fn a_resumed_run_ends_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let (splats, cameras) = (shell(), cameras());
    let rays = 120_000;
    let started = || {
        let run = Estimation::new(&splats, &cameras).domain(domain()).rays(settings(rays)).grid(grid());
        run.checkpoint(Checkpoint::new(folder.path().join("run.chk")))
    };
    let monitor = After(AtomicU64::new(60_000));
    assert!(matches!(started().monitor(&monitor).run(), Err(Error::Interrupted)));
    let resumed = started().run().unwrap();
    assert_eq!(resumed.progress.rays, rays);
    assert!(resumed.field == run(&splats, &cameras, rays));
}

#[test]
fn octree_and_dense_agree() {
    let (splats, cameras) = (shell(), cameras());
    let dense = grid().grid(GridKind::Dense);
    let run = Estimation::new(&splats, &cameras).domain(domain()).rays(settings(20_000)).grid(grid());
    let fields = run.prepare().unwrap().finish_on(&[grid(), dense]).unwrap();
    let compared = octobayes::uncertainty::compare(&fields[0].field, &fields[1].field, 20_000, 1).unwrap();
    assert!(compared.in_box.clone().unwrap().max <= 0.01 + 1e-6, "{compared:?}");
    assert!(compared.on_surfaces.clone().unwrap().points > 1000);
}

#[test]
fn a_run_is_the_sum_of_its_samples() {
    let (splats, cameras) = (shell(), cameras());
    let mut builder = FieldBuilder::new(grid(), domain()).unwrap();
    let run = Estimation::new(&splats, &cameras).domain(domain()).rays(settings(20_000)).grid(grid());
    let tapped = run.tap(|batches| {
        builder.add(batches);
        Ok(())
    });
    let outcome = tapped.run().unwrap();
    let other = builder.finish(&FieldSource { progress: outcome.progress, ..FieldSource::default() }).unwrap();
    let compared = octobayes::uncertainty::compare(&outcome.field, &other, 5000, 1).unwrap();
    assert_eq!(compared.in_box.clone().unwrap().max, 0.0, "{compared:?}");
}

#[test]
fn what_is_seen_is_certain_and_what_is_not_is_unknown() {
    let (splats, cameras) = (shell(), cameras());
    let field = run(&splats, &cameras, 20_000);
    // The cameras stand between 0 and 2.1 radians around z.
    let at = |angle: f32| Vec3::new(0.8 * angle.cos(), 0.8 * angle.sin(), 0.0);
    let [seen, unseen] = [1.0, 1.0 + std::f32::consts::PI].map(|angle| field.query(at(angle)).uncertainty);
    assert!(seen < 0.1 * unseen, "{seen} against {unseen}");
}

/// Splats behind others are in pixels, too, by the little light that passes: once they counted as constrained.
#[test]
fn splats_that_no_ray_reaches_were_never_seen_whatever_their_uncertainty() {
    let (splats, cameras) = (shell(), cameras());
    let field = run(&splats, &cameras, 20_000);
    // A point of the sphere faces a camera at c if x · c > r², by a margin if x · c is far above that.
    let facing = |x: &Vec3| {
        let dots = cameras.iter().map(|camera| x.as_dvec3().dot(camera.position) / 0.64);
        dots.fold(f64::NEG_INFINITY, f64::max)
    };
    let of = |keep: &dyn Fn(f64) -> bool| -> Vec<(f64, Observability)> {
        let means = splats.means().iter().skip(1).filter(|x| keep(facing(x)));
        let answer = |x: &Vec3| {
            let u = field.query(*x).uncertainty;
            (u / field.prior(), field.observability(*x, u).unwrap())
        };
        means.map(answer).collect()
    };
    let (front, back) = (of(&|facing| facing > 1.5), of(&|facing| facing < 0.0));
    let unseen = |all: &[(f64, Observability)]| all.iter().filter(|(_, seen)| *seen == Observability::Unseen).count();
    assert_eq!(unseen(&front), 0, "of {}", front.len());
    assert!(unseen(&back) as f64 > 0.9 * back.len() as f64, "{} of {}", unseen(&back), back.len());
    let informed = |(ratio, seen): &(f64, Observability)| *ratio < 0.1 && *seen == Observability::Unseen;
    assert!(back.iter().filter(|at| informed(at)).count() > 20, "U alone does not tell it");
    // The clean-up leaves none of them, below the prior.
    let prior = field.prior().log10();
    let kept = is_certain(splats.means(), &BakedField::unbaked(&field), prior - 1e-3);
    let is_unseen = |i: usize| {
        field.observability(splats.mean(i), field.query(splats.mean(i)).uncertainty) == Some(Observability::Unseen)
    };
    assert!((0..splats.len()).all(|i| !(kept[i] && is_unseen(i))));
    assert!(is_certain(splats.means(), &BakedField::unbaked(&field), prior).iter().all(|kept| *kept));
}

#[test]
fn sight_tells_cameras_that_see_the_splats_from_others() {
    let (splats, cameras) = (shell(), cameras());
    let stream = settings(5000).stream(&splats, &cameras, &lattice(), &Silent).unwrap();
    let right = CoverageCheck::measure(&stream, &domain(), &Silent).unwrap();
    assert!(right.meet_domain > 0.3 && right.causes().is_none() && right.cut_off().is_none(), "{right:?}");
    let turned: Vec<Camera> = cameras.iter().map(octobayes::geometry::opencv).collect();
    let stream = settings(5000).stream(&splats, &turned, &lattice(), &Silent).unwrap();
    let wrong = CoverageCheck::measure(&stream, &domain(), &Silent).unwrap();
    assert!(wrong.is_empty() && wrong.causes().unwrap().contains("OpenCV"), "{wrong:?}");
}

#[test]
fn the_domain_leaves_out_what_hardly_a_ray_meets() {
    let (splats, cameras) = (shell(), cameras());
    let renderer = SplatRenderer::new(&splats, Vec3::ZERO);
    let Domain::Box(bounds) = seen_domain(&renderer, &cameras, &Silent).unwrap().domain else { panic!("a box") };
    // The far splat makes the box of all centres a hundred times as large.
    assert!(splats.bounds().longest_edge() > 40.0);
    assert!(bounds.longest_edge() < 2.2 && bounds.longest_edge() > 1.5, "{bounds:?}");
    // Cameras inside the shell, which has windows through which far matter is seen.
    let is_far = |x: &Vec3| x.z > 0.74 || x.x > 0.74;
    let means = splats.means();
    let unbounded = Splats::new(
        means.iter().map(|x| if is_far(x) { 30.0 * *x } else { *x }).collect(),
        means.iter().zip(splats.log_scales()).map(|(x, s)| if is_far(x) { *s + 30_f32.ln() } else { *s }).collect(),
        (0..splats.len()).map(|i| splats.rotation(i)).collect(),
        splats.opacity_logits().to_vec(),
        (0..splats.len()).flat_map(|i| splats.sh(i).to_vec()).collect(),
        1,
        RenderMode::Classic,
    );
    let unbounded = unbounded.unwrap();
    let inside: Vec<Camera> = (0..6)
        .map(|i| {
            let to = DVec3::AXES[i % 3] * if i < 3 { 1.0 } else { -1.0 };
            let up = DVec3::AXES[(i + 1) % 3];
            Camera::look_at(-0.1 * to, to, up, 1.5, [64, 64])
        })
        .collect();
    let renderer = SplatRenderer::new(&unbounded, Vec3::ZERO);
    let domain = seen_domain(&renderer, &inside, &Silent).unwrap().domain;
    let Domain::Contracted { center, radius, .. } = domain else { panic!("{domain:?}") };
    assert!(center.iter().all(|c| c.abs() < 0.3) && (0.05..0.5).contains(&radius), "{domain:?}");
}

/// A sky around an object is most of what cameras see, and no reason for cells that are larger than the object.
#[test]
fn a_sky_does_not_change_the_domain_of_an_object() {
    let (object, cameras) = (shell(), cameras());
    let domain_of = |splats: &Splats, cameras: &[Camera]| {
        seen_domain(&SplatRenderer::new(splats, Vec3::ZERO), cameras, &Silent).unwrap()
    };
    let alone = domain_of(&object, &cameras);
    assert_eq!(alone.behind, 0.0);
    for (radius, count) in [(10.0, 4000), (25.0, 40), (100.0, 4000), (1e5, 400)] {
        let at = |i: usize| {
            let (z, angle) = (1.0 - (2.0 * i as f32 + 1.0) / count as f32, i as f32 * 2.399_963);
            radius * Vec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z)
        };
        let size = (radius * 3.0 / (count as f32).sqrt()).ln();
        let all = object.len() + count;
        let join =
            |a: &mut dyn Iterator<Item = Vec3>, b: &mut dyn Iterator<Item = Vec3>| a.chain(b).collect::<Vec<_>>();
        let with_sky = Splats::new(
            join(&mut object.means().iter().copied(), &mut (0..count).map(at)),
            join(&mut object.log_scales().iter().copied(), &mut (0..count).map(|_| Vec3::splat(size))),
            (0..all).map(|i| if i < object.len() { object.rotation(i) } else { Quat::IDENTITY }).collect(),
            (0..all).map(|i| if i < object.len() { object.opacity_logits()[i] } else { 5.0 }).collect(),
            (0..all).flat_map(|i| if i < object.len() { object.sh(i).to_vec() } else { vec![0.5; 12] }).collect(),
            1,
            RenderMode::Classic,
        );
        let seen = domain_of(&with_sky.unwrap(), &cameras);
        let (Domain::Box(expected), Domain::Box(found)) = (alone.domain, seen.domain) else { panic!("{seen:?}") };
        let ratio = found.longest_edge() / expected.longest_edge();
        assert!((0.9..1.1).contains(&ratio) && (0.1..0.95).contains(&seen.behind), "{radius}, {count}: {seen:?}");
    }
}

#[test]
fn what_only_volumes_have_is_refused() {
    let (splats, cameras) = (shell(), cameras());
    let start = || Estimation::new(&splats, &cameras).domain(domain());
    let refused = |run: Estimation, what: &str| {
        let error = run.prepare().err().unwrap_or_else(|| panic!("{what} is refused")).to_string();
        assert!(error.contains(what) && error.contains("splats"), "{error}");
    };
    let rays = settings(5000);
    refused(start().rays(rays.march_step(0.1)), "march step");
    refused(start().rays(rays.gradient(GradientMethod::Analytic)), "gradient");
    refused(start().rays(rays.step(0.1)), "finite-difference step");
    refused(start().rays(rays.cutoff(0.0)), "cutoff");
    refused(start().rays(rays.occupancy(64)), "occupancy");
    refused(start().rays(rays.pixels(Pixels::Random)), "pixels");
    refused(start().rays(rays).until_mean_error(0.1), "mean error");
    let density: Criteria = [Criterion::Density].into_iter().collect();
    refused(start().rays(rays).grid(grid().criteria(density)), "criterion `density`");
    let run = start().rays(rays).prepare().unwrap();
    assert!(run.audit().unwrap_err().to_string().contains("audit"));
    assert!(run.check_step().unwrap().is_none());
    // A forecast looks through few cameras.
    assert!(run.forecast().unwrap().vertices > 100.0);
}
