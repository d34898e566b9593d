use glam::{DVec3, Quat, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::cloud::{LOGIT, MEAN, ROTATION, Row, SCALE, SH, WIDTH, constant_of, rows, splats};
use super::picture::Picture;
use super::*;
use crate::{Budget, Run, StateFile, Training};
use octobayes::geometry::{Aabb, Camera};
use octobayes::monitor::Silent;
use octobayes::render::Renderer;
use octobayes_data::{PosedImage, ScenePoint};
use octobayes_splats::reference::{Gaussian, gaussians, shown};
use octobayes_splats::{MAX_DEGREE, RenderMode, SplatRenderer, Splats};

const BACKGROUND: Vec3 = Vec3::new(0.2, 1.0, 0.6);

/// A cloud of `n` splats of all shapes in the cube [-1, 1]³, some opaque.
fn cloud(n: usize) -> Vec<Row> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut number = |low: f32, high: f32| rng.random_range(low..high);
    let mut row = || {
        let mut row = [0.0; WIDTH];
        row[MEAN..SCALE].fill_with(|| number(-1.0, 1.0));
        row[SCALE..ROTATION].fill_with(|| number(-4.5, -1.5));
        let turn = Quat::from_array(std::array::from_fn(|_| number(-1.0, 1.0))).normalize();
        row[ROTATION..LOGIT].copy_from_slice(&turn.to_array());
        row[LOGIT] = number(-3.0, 6.0);
        row[SH..SH + 3].fill_with(|| number(-1.0, 1.0));
        row[SH + 3..].fill_with(|| number(-0.25, 0.25));
        row
    };
    (0..n).map(|_| row()).collect()
}

/// A camera near the cloud, so that some splats lie beside and behind the image.
fn near() -> Camera {
    Camera::look_at(DVec3::new(1.6, -1.1, 0.7), DVec3::new(0.1, 0.0, 0.2), DVec3::Z, 1.2, [60, 44])
}

/// Two compositors that share no code, one in f32 and one in f64.
#[test]
fn images_are_those_of_the_renderer() {
    let rows = cloud(600);
    let image = Picture::new(&rows, &near(), MAX_DEGREE).image(BACKGROUND);
    let splats = splats(&rows, MAX_DEGREE).unwrap();
    let renderer = SplatRenderer::new(&splats, BACKGROUND);
    let view = renderer.image(&near(), 0.5, &[], &Silent).unwrap();
    let mut away: Vec<f64> = (image.iter().zip(&view.pixels))
        .map(|(found, pixel)| (found.as_dvec3() - pixel.color).abs().max_element())
        .collect();
    away.sort_by(f64::total_cmp);
    // f32 places an ellipse to 60 px times some roundings of 6e-8, 1e-5 px, on slopes of up to 1 / px. A splat that
    // only one program draws changes a pixel by 1/255 at most, and one at which a ray ends by 1e-4 / (1 - 0.99).
    let [usual, most] = [away[away.len() * 99 / 100], away[away.len() - 1]];
    assert!(usual < 5e-5 && most < 1.1e-2, "{usual:e} {most:e}");
    assert!(view.pixels.iter().filter(|pixel| pixel.opacity > 0.5).count() > 1000);
}

/// What a parameter of the slow reference is moved by.
fn moved(gaussian: &Gaussian, parameter: usize, by: f64) -> Gaussian {
    let mut out = gaussian.clone();
    match parameter {
        SCALE..ROTATION => out.log_scale[parameter - SCALE] += by,
        // The reference has w first.
        ROTATION..LOGIT => out.quaternion[(parameter - ROTATION + 1) % 4] += by,
        LOGIT => {
            let logit = (out.opacity / (1.0 - out.opacity)).ln() + by;
            out.opacity = 1.0 / (1.0 + (-logit).exp());
        }
        SH.. => out.sh[(parameter - SH) / 3][(parameter - SH) % 3] += by,
        _ => out.mean[parameter] += by,
    }
    out
}

#[test]
fn gradients_are_those_of_the_reference() {
    // Rounding of f64, 1e-16 / H, and H² of third derivatives of lengths near 0.01: 1e-8 of the gradient each.
    const H: f64 = 1e-6;
    let (rows, camera) = (cloud(60), near());
    let slow = gaussians(&splats(&rows, MAX_DEGREE).unwrap());
    let picture = Picture::new(&rows, &camera, MAX_DEGREE);
    let image = picture.image(BACKGROUND);
    // A linear loss of some pixels.
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut by_pixel = vec![Vec3::ZERO; image.len()];
    let some: Vec<usize> = (0..image.len()).step_by(61).collect();
    some.iter().for_each(|&i| by_pixel[i] = Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))));
    let found = picture.pull_back(&rows, &image, &by_pixel);
    let background = BACKGROUND.to_array().map(f64::from);
    let seen = |all: &[Gaussian], i: usize| {
        let at = [(i % 60) as f64 + 0.5, (i / 60) as f64 + 0.5];
        shown(all, RenderMode::Classic, &camera, background, at)
    };
    let here: Vec<_> = some.iter().map(|&i| seen(&slow, i)).collect();
    // Of each kind of parameters: largest difference, largest derivative, number of comparisons.
    let kinds = [MEAN..SCALE, SCALE..ROTATION, ROTATION..LOGIT, LOGIT..SH, SH..SH + 3, SH + 3..WIDTH];
    let mut of = vec![(0.0_f64, 0.0_f64, 0); kinds.len()];
    let mut changed = 0;
    for (ellipse, (gradient, _)) in picture.ellipses.iter().zip(&found) {
        let splat = ellipse.splat as usize;
        for (kind, of) in kinds.iter().zip(&mut of) {
            for parameter in kind.clone().step_by(if kind.len() > 4 { 7 } else { 1 }) {
                let mut others = slow.clone();
                let mut loss = |by: f64| {
                    others[splat] = moved(&slow[splat], parameter, by);
                    let views: Vec<_> = some.iter().map(|&i| seen(&others, i)).collect();
                    let is_same = views.iter().zip(&here).all(|(a, b)| a.hits == b.hits);
                    let sum = |(&i, view): (&usize, &octobayes_splats::reference::Shown)| {
                        by_pixel[i].as_dvec3().dot(DVec3::from(view.color))
                    };
                    (is_same, some.iter().zip(&views).map(sum).sum::<f64>())
                };
                let ([same_up, same_down], [up, down]) = {
                    let (up, down) = (loss(H), loss(-H));
                    ([up.0, down.0], [up.1, down.1])
                };
                if !(same_up && same_down) {
                    changed += 1;
                    continue;
                }
                let numeric = (up - down) / (2.0 * H);
                of.0 = of.0.max((numeric - f64::from(gradient[parameter])).abs());
                of.1 = of.1.max(numeric.abs());
                of.2 += 1;
            }
        }
    }
    println!("{of:?}, {changed} left out");
    for (k, (away, largest, count)) in of.into_iter().enumerate() {
        // Sums over dozens of pixels of terms that cancel, in f32.
        assert!(away < 4e-5 * largest && largest > 1e-2 && count > 20, "{k}: {away:e} of {largest}, {count}");
    }
    assert!(changed < 60, "{changed}");
}

/// Images of a few splats of plain colours, with alpha.
fn shots(count: usize) -> Vec<Shot> {
    let mut rows = cloud(12);
    for row in &mut rows {
        row[MEAN..SCALE].iter_mut().for_each(|x| *x *= 0.5);
        row[SCALE..ROTATION].fill(-1.9);
        row[LOGIT] = 3.0;
        row[SH + 3..].fill(0.0);
    }
    let shot = |i: usize| {
        let turn = i as f64 / count as f64 * std::f64::consts::TAU;
        let eye = 3.0 * DVec3::new(turn.cos(), turn.sin(), 0.4 * (i % 3) as f64 - 0.3);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [40, 36]);
        let picture = Picture::new(&rows, &camera, 0);
        let [black, white] = [Vec3::ZERO, Vec3::ONE].map(|background| picture.image(background));
        let byte = |v: f32| (255.0 * v).round().clamp(0.0, 255.0) as u8;
        let pixel = |(black, white): (&Vec3, &Vec3)| {
            let alpha = 1.0 - (white.x - black.x);
            let [r, g, b] = (*black / alpha.max(1e-6)).to_array().map(byte);
            [r, g, b, byte(alpha)]
        };
        let image = PosedImage::new([40, 36], black.iter().zip(&white).map(pixel).collect());
        Shot { name: format!("r_{i}"), camera, image, mask: None }
    };
    (0..count).map(shot).collect()
}

fn bounds() -> Aabb {
    Aabb::centered_cube(1.5)
}

fn small() -> SplatSettings {
    SplatSettings::default().most(240)
}

fn run_steps(trainer: &mut SplatTrainer, steps: u64, of: u64) {
    while trainer.steps() < steps {
        trainer.step(trainer.steps() as f64 / of as f64);
    }
}

fn bits(trainer: &SplatTrainer) -> Vec<u32> {
    let rows = [&trainer.rows, &trainer.means, &trainer.squares].into_iter().flatten().flatten();
    rows.chain(trainer.asked.iter().flatten()).map(|v| v.to_bits()).collect()
}

#[test]
fn training_shows_held_out_images_and_the_renderer_agrees() {
    let all = shots(16);
    let (train, held_out): (Vec<Shot>, Vec<Shot>) = all.into_iter().partition(|shot| shot.name != "r_5");
    let mut trainer = SplatTrainer::new(small(), bounds(), &[], &train).unwrap();
    assert!(trainer.origin() == SplatOrigin::Hull && trainer.len() == 60);
    let psnr = |trainer: &SplatTrainer| trainer.look(&held_out, usize::MAX, None).unwrap().psnr;
    let before = psnr(&trainer);
    run_steps(&mut trainer, 500, 500);
    let after = psnr(&trainer);
    println!("{before} dB, {after} dB");
    assert!(before < 22.0 && after > 30.0, "{before} {after}");
    // It may grow by a twelfth three times.
    assert!((61..=78).contains(&trainer.len()), "{}", trainer.len());
    let splats: Splats = trainer.splats().unwrap();
    let renderer = SplatRenderer::new(&splats, Vec3::ONE);
    let view = renderer.image(&held_out[0].camera, 0.5, &[], &Silent).unwrap();
    let found: Vec<DVec3> = view.pixels.iter().map(|pixel| pixel.color).collect();
    let truth: Vec<DVec3> = (0..found.len()).map(|i| held_out[0].image.over(i, DVec3::ONE)).collect();
    assert!((octobayes::metrics::psnr(&found, &truth) - after).abs() < 0.01);
}

/// The images of [`shots`] without transparency.
fn opaque_shots(count: usize) -> Vec<Shot> {
    let opaque = |shot: Shot| {
        let pixels = (0..shot.image.len()).map(|i| {
            let [r, g, b] = shot.image.over(i, DVec3::ZERO).to_array().map(|v| (255.0 * v).round() as u8);
            [r, g, b, 255]
        });
        let image = PosedImage::new(shot.image.resolution, pixels.collect());
        Shot { image, ..shot }
    };
    shots(count).into_iter().map(opaque).collect()
}

#[test]
fn opaque_images_begin_anywhere_in_the_box() {
    let shots = opaque_shots(8);
    let settings = small().background(Background::Fixed([0.0; 3]));
    let mut trainer = SplatTrainer::new(settings, bounds(), &[], &shots).unwrap();
    assert_eq!(trainer.origin(), SplatOrigin::Box);
    assert!(trainer.splats().unwrap().means().iter().all(|x| bounds().contains(*x)));
    let psnr = |trainer: &SplatTrainer| trainer.look(&shots, 1, None).unwrap().psnr;
    let before = psnr(&trainer);
    run_steps(&mut trainer, 300, 300);
    assert!(psnr(&trainer) > before + 5.0, "{before} {}", psnr(&trainer));
}

#[test]
fn opaque_images_begin_at_the_points_of_a_reconstruction() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut number = || rng.random_range(-1.0..1.0);
    let points: Vec<ScenePoint> = (0..150)
        .map(|i| ScenePoint { position: DVec3::new(number(), number(), number()), color: [i, 0, 255] })
        .collect();
    let shots = opaque_shots(2);
    let with = |points: &[ScenePoint], most: usize| SplatTrainer::new(small().most(most), bounds(), points, &shots);
    // A quarter of the most at first: here all points; and as large as the distance to three neighbours.
    let trainer = with(&points, 1000).unwrap();
    assert_eq!((trainer.origin(), trainer.len()), (SplatOrigin::Points, 150));
    for (i, row) in trainer.rows.iter().enumerate() {
        let mean = DVec3::from(std::array::from_fn(|k| f64::from(row[MEAN + k])));
        let point = points.iter().find(|point| point.position.distance(mean) < 1e-6).expect("one of the points");
        let mut squares: Vec<f64> =
            points.iter().map(|other| other.position.distance_squared(point.position)).collect();
        squares.sort_by(f64::total_cmp);
        let size = (squares[1..4].iter().sum::<f64>() / 3.0).sqrt();
        assert!((f64::from(row[SCALE].exp()) / size - 1.0).abs() < 1e-5, "{i}");
        let color = constant_of(Vec3::from(point.color.map(f32::from)) / 255.0).to_array();
        assert!(row[SH..SH + 3].iter().zip(color).all(|(found, v)| (found - v).abs() < 1e-5), "{i}");
    }
    // Some of many points, the same for any order of threads; and no start at too few points.
    let [a, b] = [with(&points, 240).unwrap(), with(&points, 240).unwrap()];
    assert!(a.len() == 60 && bits(&a) == bits(&b));
    assert_eq!(with(&points[..99], 1000).unwrap().origin(), SplatOrigin::Box);
    // Points that coincide count as one; two that do among others still have a size.
    let twins = vec![points[0]; 100];
    assert_eq!(with(&twins, 1000).unwrap().origin(), SplatOrigin::Box);
    let pair = [&points[..], &[points[0]; 4]].concat();
    assert!(with(&pair, 1000).is_ok_and(|trainer| trainer.splats().is_ok()));
    // The box of points leaves out those that are far away.
    let far = ScenePoint { position: DVec3::splat(1e3), ..points[0] };
    let found = box_of_points(&[&points[..], &[far]].concat()).unwrap();
    assert!(found.size().max_element() < 2.5 && found.size().min_element() > 2.0, "{found:?}");
    assert!(box_of_points(&points[..99]).is_none() && box_of_points(&twins).is_none());
}

#[test]
fn a_resumed_run_ends_with_the_same_bits_for_any_number_of_threads() {
    let shots = shots(8);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.state");
    let mut whole = SplatTrainer::new(small(), bounds(), &[], &shots).unwrap();
    let with = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    with(1).install(|| run_steps(&mut whole, 260, 260));

    let mut first = SplatTrainer::new(small(), bounds(), &[], &shots).unwrap();
    // After the first growth, in the middle of a round.
    with(3).install(|| run_steps(&mut first, 123, 260));
    first.save(&path, "this run", 1.5).unwrap();
    let mut second = SplatTrainer::new(small(), bounds(), &[], &shots).unwrap();
    assert_eq!(second.restore(&path, "this run").unwrap(), 1.5);
    assert!(second.len() > 60);
    with(2).install(|| run_steps(&mut second, 260, 260));
    assert!(bits(&whole) == bits(&second));

    let error = second.restore(&path, "another run").unwrap_err().to_string();
    assert!(error.contains("this run") && error.contains("another run"), "{error}");
    let bytes = std::fs::read(&path).unwrap();
    for bad in [&bytes[..bytes.len() - 1], &bytes[..40], &[&bytes[..bytes.len() - 9], &[1; 9]].concat()] {
        std::fs::write(&path, bad).unwrap();
        assert!(second.restore(&path, "this run").unwrap_err().to_string().contains("run.state"));
    }
    std::fs::write(&path, &bytes).unwrap();
    let error =
        SplatTrainer::new(small().most(20), bounds(), &[], &shots).unwrap().restore(&path, "this run").unwrap_err();
    assert!(error.to_string().contains("up to 20"), "{error}");
    assert!(SplatTrainer::check_state(&path).is_ok());
}

#[test]
fn a_run_that_diverges_ends_with_an_error() {
    let shots = shots(4);
    for rates in [Rates { mean: f32::INFINITY, ..small().rates }, Rates { color: f32::INFINITY, ..small().rates }] {
        let mut trainer = SplatTrainer::new(small().rates(rates), bounds(), &[], &shots).unwrap();
        let run = Run { budget: Budget::Steps(5), held_out: &[], pixels: 0, looks: 0, state: None::<StateFile> };
        let error = run.train(&mut trainer, 0.0, &Silent, |_| ()).unwrap_err().to_string();
        assert!(error.starts_with("rates: expected rates at which"), "{error}");
    }
}

#[test]
fn what_cannot_be_trained_is_refused() {
    let mut shots = shots(2);
    let error = SplatTrainer::new(small().most(0), bounds(), &[], &shots).err().unwrap().to_string();
    assert_eq!(error, "most splats: expected at least one, found 0");
    shots[1].camera.distortion.k[0] = 0.1;
    let error = SplatTrainer::new(small(), bounds(), &[], &shots).err().unwrap().to_string();
    assert!(error.contains("no lens distortion"), "{error}");
}

#[test]
fn a_refit_keeps_order_degree_and_number_and_shows_images_better() {
    let shots = shots(8);
    let mut trainer = SplatTrainer::new(small(), bounds(), &[], &shots).unwrap();
    run_steps(&mut trainer, 200, 400);
    let trained = trainer.splats().unwrap();
    for degree in [0, 3] {
        let of_degree = splats(&rows(&trained), degree).unwrap();
        let Refitted { splats, psnr } = refit(&of_degree, &shots, small(), 60, &Silent).unwrap();
        let [before, after] = psnr.unwrap();
        assert!(after > before + 0.2, "degree {degree}: {before} {after}");
        assert_eq!((splats.len(), splats.degree()), (of_degree.len(), degree));
        // Adam moves a number by its rate at most: 60 steps of 1.6e-3 * 0.01^0.7 of half the box of the centres.
        let most = 60.0 * 6.4e-5 * 0.5 * trained.main_box().longest_edge() as f32;
        let moved = splats.means().iter().zip(of_degree.means()).map(|(a, b)| (*a - *b).abs().max_element());
        assert!(moved.fold(0.0, f32::max) < 1.5 * most);
    }
    let mip = trained.with_mode(RenderMode::MipSplatting);
    let refused = refit(&mip, &shots, small(), 9, &Silent).unwrap_err().to_string();
    assert!(refused.starts_with("--refit: expected splats that are drawn as `classic`"), "{refused}");
}
