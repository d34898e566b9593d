use glam::{DVec3, Vec3};

use super::batch::{GROUP, Scene, group};
use super::march::{Sample, Walk};
use super::occupancy::OccupancyGrid;
use super::*;
use octobayes::estimate::RaySettings;
use octobayes::field::{ClosedForm, RadianceField};
use octobayes::geometry::{Camera, Domain, Mask, Norm, Ray};
use octobayes::monitor::{Monitor, Silent};
use octobayes::rays::{PixelSequence, Pixels};
use octobayes::render::render_view;
use octobayes_data::PosedImage;
use octobayes_models::hash_grid::slow::{SlowField, random_parameters};
use octobayes_models::hash_grid::{LAYERS, N_FEATURES_PER_LEVEL, Space, Transposed};

/// True images of a closed-form scene: colour over black, and opacity, as 8-bit straight alpha.
fn shots(scene: &ClosedForm, cameras: &[Camera]) -> Vec<Shot> {
    let settings = RaySettings::default().occupancy(32).cutoff(1e-4).background(Vec3::ZERO);
    let tracer = settings.tracer(scene, 0.0, &Silent).unwrap();
    let byte = |v: f64| (255.0 * v).round().clamp(0.0, 255.0) as u8;
    cameras
        .iter()
        .enumerate()
        .map(|(i, &camera)| {
            let view = render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap();
            let pixel = |p: &octobayes::render::Pixel| {
                let color = p.color / p.opacity.max(1e-6);
                [byte(color.x), byte(color.y), byte(color.z), byte(p.opacity)]
            };
            let image = PosedImage::new(camera.resolution, view.pixels.iter().map(pixel).collect());
            Shot { name: format!("r_{i}"), camera, image, mask: None }
        })
        .collect()
}

/// The courtyard with its images: for training, and held-out ones between them.
fn courtyard(resolution: u32) -> (Domain, [Vec<Shot>; 2]) {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(16, [resolution; 2]);
    let (mut train, mut held_out) = (Vec::new(), Vec::new());
    for (i, shot) in shots(&scene, &cameras).into_iter().enumerate() {
        if i % 8 == 5 { held_out.push(shot) } else { train.push(shot) }
    }
    (Domain::Box(scene.bounds()), [train, held_out])
}

fn small() -> TrainSettings {
    let config = HashGridConfig::default().log2_hashmap_size(12).base_resolution(8).per_level_scale(1.3).occupancy(32);
    TrainSettings { config, samples_per_step: 1 << 13, ..TrainSettings::default() }
}

/// Trains up to step `steps` of a run of `of` steps.
fn run_steps(trainer: &mut Trainer, steps: u64, of: u64) {
    while trainer.steps() < steps {
        trainer.step(trainer.steps() as f64 / of as f64);
    }
}

/// All numbers that a resumed run needs, as bits.
fn bits(trainer: &Trainer) -> Vec<u32> {
    let network = trainer.parameters.network.layers().concat();
    let moments = [&trainer.network_moments.mean, &trainer.network_moments.square].map(|n| n.layers().concat());
    let tables = [&trainer.parameters.encoding.table, &trainer.table_moments.mean, &trainer.table_moments.square];
    let all = network.iter().chain(moments.iter().flatten()).chain(&trainer.occupancy.densities);
    all.chain(tables.into_iter().flatten().flatten()).map(|v| v.to_bits()).collect()
}

#[test]
#[ignore = "slow: several seconds"]
fn gradients_are_those_of_the_definition() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand::rngs::ChaCha8Rng::seed_from_u64(1);
    let (_, [shots, _]) = courtyard(24);
    // Contracted, so that steps differ in length; few samples, so that the definition is fast.
    for domain in [
        Domain::Box(ClosedForm::courtyard().bounds()),
        Domain::contracted(DVec3::new(0.1, 0.0, 0.2), 0.5, Norm::L2).unwrap(),
    ] {
        let space = Space::new(domain).unwrap();
        let parameters = random_parameters(|most| rng.random_range(-most..most));
        let cameras: Vec<Camera> = shots.iter().map(|shot| shot.camera).collect();
        let mut occupancy = OccupancyGrid::new(8, &space, &cameras);
        let densities = (0..512).map(|_| if rng.random_bool(0.1) { 1e9 } else { 0.0 }).collect();
        occupancy = OccupancyGrid::restore(occupancy.resolution(), &space, densities);
        let pixels = PixelSequence::new(Pixels::Sobol, 3, cameras.iter().map(|camera| camera.resolution).collect());
        let transposed = Transposed::new(&parameters.network);
        let background = Background::Fixed([0.9, 0.2, 0.6]);
        let scene = Scene {
            shots: &shots,
            pixels: &pixels,
            space: &space,
            occupancy: &occupancy,
            parameters: &parameters,
            transposed: &transposed,
            background,
            distortion: 0.2,
            seed: 5,
        };
        let found = group(&scene, 64, GROUP);

        // The same rays, sample by sample.
        let rays: Vec<(Ray, DVec3, Vec<Sample>)> = pixels
            .picks(64, GROUP)
            .iter()
            .map(|pick| {
                let shot = &shots[pick.camera];
                let [x, y] = pick.pixel;
                let ray = shot.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let target = shot.image.over((y * 24 + x) as usize, background.for_images().as_dvec3());
                let mut walk = Walk::new(&space, ray, pick.jitter);
                let samples = std::iter::from_fn(|| walk.next(&space, &occupancy)).collect();
                (ray, target, samples)
            })
            .collect();
        let sampled: usize = rays.iter().map(|ray| ray.2.len()).sum();
        assert!(found.u.len() == sampled && sampled > 300, "no ray ends early here: {} {sampled}", found.u.len());
        let loss = |field: &SlowField| -> f64 {
            rays.iter().map(|(ray, target, samples)| loss_slowly(field, &space, ray, *target, samples)).sum()
        };
        let slow = SlowField::new(&parameters);
        // Sums of a few thousand f32 terms.
        assert!((loss(&slow) / found.loss - 1.0).abs() < 1e-4, "{} {}", loss(&slow), found.loss);

        // Compared only where differences at two steps agree; elsewhere a hidden unit switches in between.
        let (mut compared, mut kinks, mut worst) = ([0; LAYERS.len() + 1], 0, 0.0_f64);
        let mut compare = |kind: usize, gradient: f64, scale: f64, change: &dyn Fn(&mut SlowField, f64)| {
            let difference = |h: f64| {
                let [high, low] = [h, -h].map(|h| {
                    let mut moved = slow.clone();
                    change(&mut moved, h);
                    loss(&moved)
                });
                (high - low) / (2.0 * h)
            };
            let (expected, coarse) = (difference(1e-5), difference(3e-5));
            if (expected - coarse).abs() > 1e-4 * scale {
                kinks += 1;
                return;
            }
            compared[kind] += 1;
            worst = worst.max((expected - gradient).abs() / scale);
            // f32 sums of thousands of terms, relative to the largest derivative of the layer.
            assert!((expected - gradient).abs() <= 1e-3 * scale, "{kind}: {expected} {gradient} of {scale}");
        };
        let largest = |values: &[f32]| f64::from(values.iter().fold(0.0_f32, |m, v| m.max(v.abs())));
        for (l, ((_, [inputs, outputs]), gradient)) in LAYERS.iter().zip(found.weights.layers()).enumerate() {
            let scale = largest(gradient);
            assert!(scale > 0.0);
            for _ in 0..12 {
                let (i, o) = (rng.random_range(0..*inputs), rng.random_range(0..*outputs));
                let own = f64::from(gradient[i * outputs + o]);
                compare(l, own, scale, &|field, h| field.layers[l][i][o] += h);
            }
        }
        let levels = *parameters.encoding.levels();
        for (l, level) in levels.iter().enumerate() {
            let mut gradient = vec![[0.0; N_FEATURES_PER_LEVEL]; level.size];
            octobayes_models::hash_grid::Encoding::add_gradient(l, level, &found.u, &found.features, &mut gradient);
            let scale = largest(gradient.as_flattened());
            let visited: Vec<usize> = (0..level.size).filter(|e| gradient[*e] != [0.0; N_FEATURES_PER_LEVEL]).collect();
            for _ in 0..4 {
                let (e, k) = (visited[rng.random_range(0..visited.len())], rng.random_range(0..N_FEATURES_PER_LEVEL));
                let own = f64::from(gradient[e][k]);
                compare(LAYERS.len(), own, scale, &|field, h| field.tables[l][e][k] += h);
            }
        }
        assert!(compared.iter().all(|n| *n >= 6) && kinks < 30, "{compared:?} {kinks} {worst:e}");
    }
}

/// Huber and distortion loss of one ray from their definitions, in f64, over all pairs of samples.
fn loss_slowly(field: &SlowField, space: &Space, ray: &Ray, target: DVec3, samples: &[Sample]) -> f64 {
    let length = space.unit_length();
    let (mut transmittance, mut color, mut weights) = (1.0, DVec3::ZERO, Vec::new());
    for sample in samples {
        let value = field.value(DVec3::from(sample.u.map(f64::from)), ray.direction.as_vec3());
        let alpha = 1.0 - (-value.sigma * sample.delta / length).exp();
        weights.push(transmittance * alpha);
        color += transmittance * alpha * DVec3::from(value.color);
        transmittance *= 1.0 - alpha;
    }
    color += transmittance * DVec3::new(0.9_f32.into(), 0.2_f32.into(), 0.6_f32.into());
    let huber = |e: f64| if e.abs() <= 0.1 { 0.5 * e * e } else { 0.1 * (e.abs() - 0.05) };
    let error = color - target;
    let mut loss = huber(error.x) + huber(error.y) + huber(error.z);
    for (a, wa) in samples.iter().zip(&weights) {
        loss += 0.2 * wa * wa * a.delta / length / 3.0;
        loss += samples.iter().zip(&weights).map(|(b, wb)| 0.2 * wa * wb * (a.t - b.t).abs() / length).sum::<f64>();
    }
    loss
}

#[test]
fn leaps_keep_the_samples_that_single_steps_keep() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand::rngs::ChaCha8Rng::seed_from_u64(2);
    let space = Space::new(Domain::Box(ClosedForm::courtyard().bounds())).unwrap();
    let mut kept = 0;
    for share in [0.002, 0.05] {
        let densities = (0..32 * 32 * 32).map(|_| if rng.random_bool(share) { 1e9 } else { 0.0 }).collect();
        let grid = OccupancyGrid::restore(32, &space, densities);
        for _ in 0..200 {
            let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0_f64)));
            // Most of them meet the box.
            let (origin, target) = (3.0 * vector(), vector());
            let ray = Ray::new(origin, target - origin);
            let mut walk = Walk::new(&space, ray, 0.25);
            let found: Vec<f64> = std::iter::from_fn(|| walk.next(&space, &grid)).map(|sample| sample.t).collect();
            let Some((entry, exit)) = space.bounds.clip(&ray) else {
                assert!(found.is_empty());
                continue;
            };
            let candidates = (0..).map(|k| entry + (f64::from(k) + 0.25) * space.step()).take_while(|t| *t < exit);
            let slowly: Vec<f64> =
                candidates.filter(|t| space.unit(ray.at(*t).as_vec3()).is_some_and(|u| grid.at(u).is_ok())).collect();
            // Steps are added up. After a few hundred, places differ by rounding, and a sample on the face
            // of a cell may be lost.
            let same = |t: &f64, others: &[f64]| others.iter().any(|other| (other - t).abs() < 1e-9);
            let missing = slowly.iter().filter(|t| !same(t, &found)).count();
            let extra = found.iter().filter(|t| !same(t, &slowly)).count();
            assert!(missing + extra <= 1, "{missing} {extra} of {}", slowly.len());
            kept += found.len();
        }
    }
    assert!(kept > 1000, "{kept}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (domain, [shots, _]) = courtyard(24);
    let trained = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut trainer = Trainer::new(small(), domain, &shots).unwrap();
            run_steps(&mut trainer, 40, 40);
            bits(&trainer)
        })
    };
    let one = trained(1);
    assert!(one == trained(2) && one == trained(3));
    assert!(one.iter().any(|b| *b != 0));
}

#[test]
fn a_small_scene_is_learnt() {
    let (domain, [shots, held_out]) = courtyard(64);
    let mut trainer = Trainer::new(small(), domain, &shots).unwrap();
    let psnr = |trainer: &Trainer| {
        let field = trainer.field(serde_json::Value::Null);
        let quality = quality(&field, &held_out, Vec3::ONE, 4096).unwrap();
        assert_eq!((quality.views, quality.pixels), (2, 2 * 32 * 32), "every second pixel of two images");
        quality.psnr
    };
    let before = psnr(&trainer);
    run_steps(&mut trainer, 250, 250);
    let after = psnr(&trainer);
    assert!(before < 13.0 && after > 24.0, "{before} {after}");
}

/// `quality` samples as training does. The renderer of all fields has another step in contracted space, and its own
/// occupancy grid.
#[test]
#[ignore = "slow: several seconds"]
fn quality_is_what_the_renderer_shows() {
    let (domain, [shots, held_out]) = courtyard(48);
    let contracted = Domain::contracted(DVec3::ZERO, 0.8, Norm::L2).unwrap();
    for (domain, tolerance) in [(domain, 0.05), (contracted, 0.3)] {
        let mut trainer = Trainer::new(small(), domain, &shots).unwrap();
        run_steps(&mut trainer, 100, 100);
        let field = trainer.field(serde_json::Value::Null);
        let found = quality(&field, &held_out, Vec3::ONE, usize::MAX).unwrap();
        let settings = RaySettings::default().cutoff(1e-4);
        let tracer = settings.tracer(&field, 0.0, &Silent).unwrap();
        let rendered = held_out.iter().map(|shot| {
            let view = render_view(&tracer, &shot.camera, 0.5, &[], &Silent).unwrap();
            let colors: Vec<DVec3> = view.pixels.iter().map(|p| p.color).collect();
            let truth: Vec<DVec3> = (0..shot.image.len()).map(|i| shot.image.over(i, DVec3::ONE)).collect();
            octobayes::metrics::psnr(&colors, &truth)
        });
        let rendered = rendered.sum::<f64>() / held_out.len() as f64;
        assert!((found.psnr - rendered).abs() < tolerance, "{} {rendered}", found.psnr);
    }
}

#[test]
fn a_resumed_run_ends_with_the_same_bits() {
    let (domain, [shots, _]) = courtyard(24);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.state");
    let mut whole = Trainer::new(small(), domain, &shots).unwrap();
    run_steps(&mut whole, 60, 60);

    let mut first = Trainer::new(small(), domain, &shots).unwrap();
    // Between two updates of the occupancy grid.
    run_steps(&mut first, 23, 60);
    first.save(&path, "this run", 1.5).unwrap();
    let mut second = Trainer::new(small(), domain, &shots).unwrap();
    assert_eq!(second.restore(&path, "this run").unwrap(), 1.5);
    run_steps(&mut second, 60, 60);
    assert!(bits(&whole) == bits(&second));
    assert_eq!((whole.rays(), whole.rays_per_step), (second.rays(), second.rays_per_step));

    let error = second.restore(&path, "another run").unwrap_err().to_string();
    assert!(error.contains("this run") && error.contains("another run"), "{error}");
    let bytes = std::fs::read(&path).unwrap();
    for bad in [&bytes[..bytes.len() - 1], &bytes[..40], &[&bytes[..bytes.len() - 9], &[1; 9]].concat()] {
        std::fs::write(&path, bad).unwrap();
        assert!(second.restore(&path, "this run").unwrap_err().to_string().contains("run.state"));
    }
    let other = TrainSettings { config: small().config.occupancy(16), ..small() };
    std::fs::write(&path, &bytes).unwrap();
    let error = Trainer::new(other, domain, &shots).unwrap().restore(&path, "this run").unwrap_err().to_string();
    assert!(error.contains("finite numbers"), "{error}");
}

/// Interrupts after a number of checks.
struct StopAfter(std::sync::atomic::AtomicU32);

impl Monitor for StopAfter {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn interrupted(&self) -> bool {
        self.0.fetch_sub(1, std::sync::atomic::Ordering::Relaxed) == 0
    }
}

#[test]
fn an_interrupted_run_keeps_its_state_and_reports_on_its_way() {
    let (domain, [shots, held_out]) = courtyard(24);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.state");
    let state = StateFile { path: path.clone(), key: "key".into(), every: std::time::Duration::MAX };
    let run = Run { budget: Budget::Steps(48), held_out: &held_out, pixels: 500, looks: 3, state: Some(state) };
    let mut trainer = Trainer::new(small(), domain, &shots).unwrap();
    let mut looks = Vec::new();
    let stop = StopAfter(20.into());
    let finished = run
        .train(&mut trainer, 0.0, &stop, |p| {
            if p.held_out.is_some() {
                looks.push(p.steps);
            }
        })
        .unwrap();
    assert!(finished.interrupted && path.exists() && trainer.steps() == 20);

    let mut resumed = Trainer::new(small(), domain, &shots).unwrap();
    let elapsed = resumed.restore(&path, "key").unwrap();
    let finished = run
        .train(&mut resumed, elapsed, &Silent, |p| {
            assert!(p.loss.is_finite() && p.train_psnr > 0.0 && p.left >= 0.0);
            if p.held_out.is_some() {
                looks.push(p.steps);
            }
        })
        .unwrap();
    assert!(!finished.interrupted && finished.elapsed >= elapsed);
    assert_eq!(looks, [16, 32], "a third, two thirds; the end is the caller's");
    let mut whole = Trainer::new(small(), domain, &shots).unwrap();
    let plain = Run { state: None, ..run };
    plain.train(&mut whole, 0.0, &Silent, |_| ()).unwrap();
    assert!(bits(&whole) == bits(&resumed));
}

#[test]
fn a_run_that_diverges_ends_with_an_error() {
    let (domain, [shots, _]) = courtyard(24);
    for rate in [1e10, 1e30] {
        let settings = TrainSettings { learning_rate: rate, ..small() };
        let mut trainer = Trainer::new(settings, domain, &shots).unwrap();
        let run = Run { budget: Budget::Steps(300), held_out: &[], pixels: 500, looks: 0, state: None };
        let error = run.train(&mut trainer, 0.0, &Silent, |_| ()).unwrap_err().to_string();
        assert!(error.starts_with("learning rate: expected a rate at which") && error.contains("at step "), "{error}");
    }
}

#[test]
fn cells_that_no_camera_sees_stay_empty() {
    let scene = ClosedForm::courtyard();
    let space = Space::new(Domain::Box(scene.bounds())).unwrap();
    // From outside, along +x, with a view a quarter as high as the box.
    let bounds = scene.bounds();
    let middle = 0.5 * (bounds.min() + bounds.max());
    let eye = middle - 3.0 * DVec3::X * bounds.size().x;
    let camera = Camera::look_at(eye, middle, DVec3::Z, 0.1, [32, 32]);
    let grid = OccupancyGrid::new(32, &space, &[camera]);
    let cell = |x: usize, y: usize, z: usize| grid.occupied()[(z * 32 + y) * 32 + x];
    assert!((0..32).all(|x| cell(x, 16, 16)));
    assert!((0..32).all(|x| !cell(x, 0, 0) && !cell(x, 31, 16)));
}

#[test]
fn a_fixed_background_and_a_contracted_space_train_too() {
    let (_, [shots, held_out]) = courtyard(32);
    let settings = TrainSettings { background: Background::Fixed([0.0; 3]), distortion: 0.01, ..small() };
    let domain = Domain::contracted(DVec3::ZERO, 0.8, Norm::Linf).unwrap();
    let mut trainer = Trainer::new(settings, domain, &shots).unwrap();
    let psnr = |trainer: &Trainer| {
        let field = trainer.field(serde_json::Value::Null);
        quality(&field, &held_out, settings.background.for_images(), 1000).unwrap().psnr
    };
    let before = psnr(&trainer);
    run_steps(&mut trainer, 120, 120);
    let after = psnr(&trainer);
    assert!(after > before + 6.0 && after > 15.0, "{before} {after}");
}

#[test]
fn shrunk_pictures_have_the_mean_of_what_they_cover() {
    let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 1.0, [4, 2]);
    let mut pixels = vec![[0; 4]; 8];
    // Two of the four pixels on the left show something, one of them a fifth of it; one on the right is opaque.
    (pixels[0], pixels[5], pixels[7]) = ([200, 0, 40, 255], [80, 0, 40, 51], [9, 8, 7, 255]);
    let shot = Shot { name: "a".into(), camera, image: PosedImage::new([4, 2], pixels), mask: None };
    let small = shot.clone().shrunk([2, 1]).unwrap();
    assert_eq!((small.camera, small.image.resolution), (camera.resized([2, 1]), [2, 1]));
    // Straight colours, weighed by alpha: (200 + 0.2 * 80) / 1.2 = 180.
    let expected = [[180.0, 0.0, 40.0, 306.0 / 4.0], [9.0, 8.0, 7.0, 255.0 / 4.0]];
    for (i, [r, g, b, a]) in expected.into_iter().enumerate() {
        // Half a step of 8 bits, in alpha and in the colour times alpha.
        assert!((255.0 * small.image.alpha(i) - a).abs() < 0.501, "{i}");
        let over = 255.0 * small.image.over(i, DVec3::ZERO);
        assert!((over - a / 255.0 * DVec3::new(r, g, b)).abs().max_element() <= 1.0, "{i}: {over}");
    }
    // The mean of a block that is masked in part would be of pixels that do not count.
    let masked = Shot { mask: Some(Mask::new([4, 2], |x, y| [x, y] != [3, 1])), ..shot.clone() };
    let small = masked.shrunk([2, 1]).unwrap();
    assert_eq!([small.keeps(0), small.keeps(1)], [true, false]);
    for (resolution, found) in [([8, 4], "8 x 4"), ([1, 2], "1 x 2"), ([5, 2], "5 x 2")] {
        let error = shot.clone().shrunk(resolution).unwrap_err().to_string();
        let expected = "--resolution: expected at most the 4 x 2 pixels of `a`, and their ratio: a width alone has it";
        assert_eq!(error, format!("{expected}, found {found}"));
    }
}

/// Three columns become two: each is a whole pixel and half of the middle one.
#[test]
fn parts_of_pixels_count_by_their_area() {
    let of = |pixels: [[u8; 4]; 3]| PosedImage::new([3, 1], pixels.to_vec()).shrunk([2, 1]);
    let opaque = of([[30, 0, 0, 255], [90, 0, 6, 255], [0, 60, 0, 255]]);
    let [left, right] = [0, 1].map(|i| 255.0 * opaque.over(i, DVec3::ZERO));
    assert_eq!([left.to_array(), right.to_array()].map(|c| c.map(f64::round)), [[50.0, 0.0, 2.0], [30.0, 40.0, 2.0]]);
    // A transparent pixel has no colour to give, whatever is stored there.
    let clear = of([[30, 0, 0, 255], [255, 255, 255, 0], [0, 0, 0, 0]]);
    assert!((255.0 * clear.alpha(0) - 170.0).abs() < 0.51 && clear.alpha(1) == 0.0);
    assert!((255.0 * clear.over(0, DVec3::ZERO) - DVec3::new(20.0, 0.0, 0.0)).abs().max_element() < 0.51);
    // One colour stays what it is at any size, and the mean of all is that of the large picture.
    let pixels: Vec<[u8; 4]> = (0..37 * 23).map(|i| [(7 * i % 251) as u8, 9, 200, 255]).collect();
    let large = PosedImage::new([37, 23], pixels);
    let mean =
        |image: &PosedImage| (0..image.len()).map(|i| image.over(i, DVec3::ZERO)).sum::<DVec3>() / image.len() as f64;
    for size in [[36, 22], [19, 12], [10, 6], [1, 1], [37, 23]] {
        let small = large.clone().shrunk(size);
        let off = 255.0 * (mean(&small) - mean(&large)).abs();
        assert!(off.x < 0.51 && off.y < 1e-9 && off.z < 1e-9 && small.resolution == size, "{size:?}: {off}");
    }
}
