//! Tests on a ball whose geometry is known in closed form.

mod splats;

use glam::{DVec3, Vec3};

use super::*;
use crate::metrics::{Calibration, ErrorKind, ensemble_variance, sparsification};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{RayAverage, Renderer, VolumeRenderer};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes_data::{DepthReadings, PosedImage};
use octobayes_depth::{DepthDeviation, Photograph, Sweep, TrainingViews};

/// An empty field in the ball's box.
struct Nothing(Aabb);

impl RadianceField for Nothing {
    fn bounds(&self) -> Aabb {
        self.0
    }

    fn evaluate(&self, _: &[Vec3], _: &[Vec3], out: &mut [Radiance]) {
        out.fill(Radiance::default());
    }

    fn suggested_step(&self) -> f64 {
        0.01
    }

    fn memory(&self) -> usize {
        0
    }
}

impl TrainedField for Nothing {
    fn describe(&self) -> String {
        "nothing".into()
    }
}

fn cameras() -> Vec<Camera> {
    ClosedForm::half_circle(3, [24, 24])
}

fn settings() -> RaySettings {
    RaySettings::default().rays(4000).occupancy(24).cutoff(1e-4)
}

fn uncertainty(ball: &ClosedForm) -> UncertaintyField {
    Estimation::new(ball, &cameras()).rays(settings()).grid(GridSettings::default().level(5)).run().unwrap().field
}

fn renderer(field: &dyn RadianceField) -> VolumeRenderer<'_> {
    VolumeRenderer { tracer: settings().tracer(field, 0.0, &Silent).unwrap(), differentiation: None }
}

/// What the ball shows. Its true distance falls short of the median depth by 0.01 more for every pixel to the right.
fn truth(ball: &ClosedForm, camera: &Camera) -> TrueView {
    let view = renderer(ball).image(camera, 0.5, &[], &Silent).unwrap();
    let width = camera.resolution[0] as usize;
    let seen = |i: usize| view.pixels[i].opacity > 0.5;
    let n = view.pixels.len();
    TrueView {
        name: "view".into(),
        camera: *camera,
        whole: *camera,
        stride: 1,
        pixel_offset: 0.5,
        colors: view.pixels.iter().map(|p| p.color).collect(),
        kept: vec![true; n],
        covered: (0..n).map(seen).collect(),
        distance: (0..n).map(|i| seen(i).then(|| view.pixels[i].median_depth - 0.01 * (i % width) as f64)).collect(),
        readings: DepthReadings::default(),
        parts: TrueParts::default(),
    }
}

#[test]
fn what_no_training_camera_saw_is_told_and_detected() {
    let ball = ClosedForm::ball();
    let field = uncertainty(&ball);
    let readings = [Reading { name: "U".into(), field, averages: vec![RayAverage::USpread] }];
    let model = renderer(&ball);
    let training = TrainingViews::render(&model, &cameras(), 0.5, &Silent).unwrap();
    // From the side and from behind, where the half circle of cameras does not reach.
    let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [24, 24]);
    let views = [DVec3::new(-3.0, 0.0, -0.5), DVec3::new(0.0, 3.0, 0.5)].map(from);
    let without = Evaluator::new(&model, &readings);
    let evaluator = Evaluator { truly_seen: Some(&training), ..Evaluator::new(&model, &readings) };
    let (mut evaluated, mut expected) = (Vec::new(), Vec::new());
    for camera in &views {
        let truth = truth(&ball, camera);
        let view = evaluator.evaluate(&truth, 0, &Silent).unwrap();
        for &i in &view.pixels {
            let [x, y] = [i % 24, i / 24].map(|n| n as f64 + 0.5);
            let surface = camera.ray(x, y).at(truth.distance[i].unwrap());
            expected.push(training.sighting(surface).views == 0);
        }
        assert!(without.evaluate(&truth, 0, &Silent).unwrap().never_seen.is_empty());
        evaluated.push(view);
    }
    let found: Vec<bool> = evaluated.iter().flat_map(|view| &view.never_seen).copied().collect();
    assert_eq!(found, expected);
    let unseen = found.iter().filter(|unseen| **unseen).count();
    assert!(unseen > 20 && found.len() - unseen > 20, "{unseen} of {}", found.len());
    // The first measure is that of U, the last is chance.
    let last = evaluator.measures().len() - 1;
    let [of_u, of_chance] = [0, last].map(|m| Evaluator::detection(&evaluated, m).unwrap());
    assert_eq!(of_u.positives, unseen as f64 / found.len() as f64);
    assert!(of_u.auroc > 0.8 && (0.3..0.7).contains(&of_chance.auroc), "{of_u:?}, {of_chance:?}");
}

/// Every kind has the figures of its own pixels, and no others.
#[test]
fn kinds_of_pixels_are_judged_apart() {
    let ball = ClosedForm::ball();
    let readings = [Reading { name: "U".into(), field: uncertainty(&ball), averages: vec![RayAverage::USpread] }];
    let model = renderer(&ball);
    let evaluator = Evaluator::new(&model, &readings);
    let camera = Camera::look_at(DVec3::new(3.0, 0.5, 0.5), DVec3::ZERO, DVec3::Z, 0.7, [48; 2]);
    let truth = truth(&ball, &camera);
    // The left third is the object; what is off by more than 0.2 is in front, as true depths are 0.01 a pixel nearer.
    let object: Vec<bool> = (0..48 * 48).map(|i| i % 48 < 16).collect();
    let silhouette = |i: usize| Outline { is_silhouette: i.is_multiple_of(7), is_thin: false };
    let outlines = (0..48 * 48).map(silhouette).collect();
    let truth = TrueView { parts: TrueParts { outlines, object, jump: 0.2, rounding: 0.0 }, ..truth };
    let views = [evaluator.evaluate(&truth, 0, &Silent).unwrap()];
    let found = OfKind::all(&evaluator, &views);
    // Thin has no pixels. No median is nearer than its true depth.
    let names: Vec<PixelKind> = found.iter().map(|of| of.kind).collect();
    assert_eq!(names, [PixelKind::Object, PixelKind::Around, PixelKind::Silhouette, PixelKind::Other]);
    let view = &views[0];
    for of in &found {
        let is = |i: usize| match of.kind {
            PixelKind::Object => i % 48 < 16,
            PixelKind::Around => i % 48 >= 16,
            PixelKind::Silhouette => i.is_multiple_of(7),
            _ => !i.is_multiple_of(7),
        };
        let chosen: Vec<usize> = (0..view.pixels.len()).filter(|&k| is(view.pixels[k])).collect();
        let of_chosen = |values: &[f64]| -> Vec<f64> { chosen.iter().map(|&k| values[k]).collect() };
        assert_eq!(of.share, chosen.len() as f64 / view.pixels.len() as f64);
        assert_eq!(of.depth_error.pixels, chosen.len());
        let errors = of_chosen(&view.absolute_error);
        for (measure, values) in of.measures.iter().zip(&view.measures) {
            let expected = sparsification(&of_chosen(values), &errors, ErrorKind::Mae).map(|curve| curve.area);
            assert_eq!(measure.ause.map(|ause| ause.mae), expected, "{}", of.kind);
        }
    }
    let shares: f64 = found[..2].iter().map(|of| of.share).sum();
    assert!((shares - 1.0).abs() < 1e-12);
}

/// What faces the middle of three cameras is seen by all of them, the sides by fewer.
#[test]
fn depths_that_training_cameras_see_are_confirmed_and_calibrated_by_themselves() {
    let ball = ClosedForm::ball();
    let model = renderer(&ball);
    let around = |azimuth: f64| {
        Camera::look_at(DVec3::new(3.0 * azimuth.cos(), 3.0 * azimuth.sin(), 0.5), DVec3::ZERO, DVec3::Z, 0.7, [96; 2])
    };
    let cameras = [-0.4, 0.0, 0.4].map(around);
    let training = TrainingViews::render(&model, &cameras, 0.5, &Silent).unwrap();
    let without = Evaluator::new(&model, &[]);
    let evaluator = Evaluator { training: Some(&training), ..Evaluator::new(&model, &[]) };
    let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [48; 2]);
    let views: Vec<EvaluatedView> = [DVec3::new(3.0, 0.0, 0.5), DVec3::new(0.0, -3.0, 0.5)]
        .iter()
        .map(|eye| evaluator.evaluate(&truth(&ball, &from(*eye)), 0, &Silent).unwrap())
        .collect();
    let (mut errors, mut deviations, mut all, mut certain) = (Vec::new(), Vec::new(), 0_usize, [0; 2]);
    for (view, eye) in views.iter().zip([DVec3::new(3.0, 0.0, 0.5), DVec3::new(0.0, -3.0, 0.5)]) {
        assert_eq!(view.confirmed.len(), view.pixels.len());
        for (k, &i) in view.pixels.iter().enumerate() {
            let [x, y] = [i % 48, i / 48].map(|n| n as f64 + 0.5);
            let point = from(eye).ray(x, y).at(view.rendered.pixels[i].median_depth);
            // The ball answers for itself: its middle is the origin. A surface that faces away from a camera by a
            // cosine of 0.3 lies 0.3 behind what the camera sees. A surface that faces it by 0.8 has its depth wrong by
            // at most 0.008, half of what depth changes across a pixel of the camera. The tolerance is 0.026.
            let normal = point.normalize();
            let cosines: Vec<f64> =
                cameras.iter().map(|camera| normal.dot((camera.position - point).normalize())).collect();
            let (all_face, one_does_not) = (cosines.iter().all(|c| *c > 0.8), cosines.iter().any(|c| *c < -0.3));
            if all_face || one_does_not {
                assert_eq!(view.confirmed[k], all_face, "{point}: {cosines:?}");
                certain[usize::from(all_face)] += 1;
            }
            if view.confirmed[k] {
                errors.push(view.absolute_error[k]);
                deviations.push(view.spread[k]);
            }
            all += 1;
        }
    }
    assert!(certain.iter().all(|count| *count > 20), "{certain:?} of {all}");
    let measures = evaluator.measures();
    let weights = measures.iter().position(|m| *m == Measure::Baseline(Baseline::RayVariance)).unwrap();
    let found = evaluator.calibration_of(&views, weights, |view| &view.confirmed).unwrap();
    assert_eq!(found.share, errors.len() as f64 / all as f64);
    assert_eq!(found.calibration, Calibration::new(&errors, &deviations));
    assert_ne!(found.calibration, evaluator.calibration(&views, weights));
    // Truth that is known in steps is as wrong as that beside the deviation.
    let known = truth(&ball, &from(DVec3::new(3.0, 0.0, 0.5)));
    let known = TrueView { parts: TrueParts { rounding: 0.3, ..known.parts.clone() }, ..known };
    let rounded = evaluator.evaluate(&known, 0, &Silent).unwrap();
    let wider: Vec<f64> = rounded.spread.iter().map(|s| (s * s + 0.09).sqrt()).collect();
    let (expected, found) =
        (Calibration::new(&rounded.absolute_error, &wider), evaluator.calibration(&[rounded], weights));
    let held = |of: Option<Calibration>| of.unwrap().coverage;
    assert!(held(found).iter().zip(held(expected)).all(|(a, b)| (a[1] - b[1]).abs() < 1e-12));
    // Without training cameras nothing is confirmed, and nothing refused.
    let view = without.evaluate(&truth(&ball, &from(DVec3::new(3.0, 0.0, 0.5))), 0, &Silent).unwrap();
    assert!(view.confirmed.is_empty() && without.calibration_of(&[view], 0, |view| &view.confirmed).is_none());
}

/// Deviations are those of the crate that `depth` uses, from the field alone and, of the first field, with the images.
#[test]
fn deviations_of_depth_are_those_of_the_field_and_of_the_images() {
    let ball = ClosedForm::ball();
    let model = renderer(&ball);
    let cameras = [-0.3, 0.0, 0.3].map(|azimuth: f64| {
        Camera::look_at(DVec3::new(3.0 * azimuth.cos(), 3.0 * azimuth.sin(), 0.0), DVec3::ZERO, DVec3::Z, 0.7, [48; 2])
    });
    let photograph = |camera: &Camera| {
        let shown = model.image(camera, 0.5, &[], &Silent).unwrap();
        let byte = |v: f64| (255.0 * v).round() as u8;
        let pixel = |color: DVec3| [byte(color.x), byte(color.y), byte(color.z), 255];
        let image = PosedImage::new([48; 2], shown.pixels.iter().map(|p| pixel(p.color)).collect());
        Photograph::new(*camera, image, None, DVec3::ONE, 0.5)
    };
    let photographs: Vec<Photograph> = cameras.iter().map(photograph).collect();
    let data = DataScale::from_cameras(&cameras, 0.05, &Domain::Box(ball.bounds())).unwrap();
    let grid = GridSettings::default().level(5).scale(Scale::Data(data));
    let field = Estimation::new(&ball, &cameras).rays(settings()).grid(grid).run().unwrap().field;
    let training = TrainingViews::render(&model, &cameras, 0.5, &Silent).unwrap();
    // The paper's scale has no lengths.
    let fields = [uncertainty(&ball), field.clone(), field.clone()];
    let reading = |field: UncertaintyField| Reading { name: "U".into(), field, averages: Vec::new() };
    let readings = fields.map(reading);
    let evaluator =
        Evaluator { training: Some(&training), photographs: Some(&photographs), ..Evaluator::new(&model, &readings) };
    let measures = evaluator.measures();
    let expected = [Measure::DepthDeviation(1), Measure::DepthDeviation(2), Measure::DepthDeviationWithImages(1)];
    assert_eq!(measures[..3], expected);
    let camera = Camera::look_at(DVec3::new(3.0, 0.2, 0.3), DVec3::ZERO, DVec3::Z, 0.7, [48; 2]);
    let view = evaluator.evaluate(&truth(&ball, &camera), 0, &Silent).unwrap();
    let baked = BakedField::unbaked(&field);
    let sweep = Sweep::new(&photographs, &training);
    for (m, sweep) in [(0, None), (1, None), (2, Some(sweep))] {
        let deviation = DepthDeviation::new(&baked, sweep).unwrap();
        let expected = deviation.of_view(&model, &camera, 0.5, &view.rendered, &Silent).unwrap();
        for (k, &i) in view.pixels.iter().enumerate() {
            // A baked field rounds U to f32.
            let (found, expected) = (view.measures[m][k], expected[i]);
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} instead of {expected}");
        }
    }
    assert_ne!(view.measures[1], view.measures[2]);
    // Without the cameras there is nothing to compare images by.
    assert_eq!(evaluator.deviation().map(|(m, _)| m), Some(2));
    let evaluator = Evaluator { training: None, ..evaluator };
    assert_eq!(evaluator.deviation().map(|(m, _)| m), Some(0));
    assert!(!evaluator.measures().contains(&Measure::DepthDeviationWithImages(1)));
}

#[test]
fn every_measure_is_of_the_same_pixels() {
    let ball = ClosedForm::ball();
    let field = uncertainty(&ball);
    let readings: Vec<Reading> = Covariance::ALL
        .iter()
        .map(|&c| Reading {
            name: c.name().into(),
            field: field.clone().with_covariance(c).unwrap(),
            averages: vec![RayAverage::WeightedMean, RayAverage::USpread],
        })
        .collect();
    let nothing = Nothing(ball.bounds());
    let (model, nothing) = (renderer(&ball), renderer(&nothing));
    let members: Vec<&dyn Renderer> = vec![&model, &nothing];
    let evaluator = Evaluator { members, ..Evaluator::new(&model, &readings) };
    let camera = cameras()[1];
    let truth = truth(&ball, &camera);
    let view = evaluator.evaluate(&truth, 7, &Silent).unwrap();
    let n = view.pixels.len();
    assert!(n > 50 && view.empty == 0 && view.psnr == f64::INFINITY, "{n} pixels");
    let measures = evaluator.measures();
    assert_eq!(measures.len(), 6 + 6);
    assert!(view.measures.len() == measures.len() && view.measures.iter().all(|m| m.len() == n));

    let of = |measure| &view.measures[measures.iter().position(|m| *m == measure).unwrap()];
    let baseline = |b| of(Measure::Baseline(b));
    for (k, &i) in view.pixels.iter().enumerate() {
        assert!((view.absolute_error[k] - 0.01 * (i % 24) as f64).abs() < 1e-12);
        let pixel = view.rendered.pixels[i];
        assert_eq!(baseline(Baseline::RayVariance)[k], pixel.depth_variance);
        // The members are the ball and nothing: the ball's depth, and the depth at which the ray leaves the box.
        let ray = camera.ray((i % 24) as f64 + 0.5, (i / 24) as f64 + 0.5);
        let exit = ball.bounds().clip(&ray).unwrap().1;
        assert_eq!(baseline(Baseline::EnsembleVariance)[k], ensemble_variance(&[pixel.median_depth, exit]));
        assert_eq!(baseline(Baseline::Distance)[k], pixel.median_depth);
        let expected = ray.at(pixel.expected_depth).as_vec3();
        let deviation = (pixel.depth_variance + model.tracer.marcher.step.powi(2) / 12.0).sqrt();
        for (r, reading) in readings.iter().enumerate() {
            let (name, log10) = (&reading.name, |x| reading.field.log10(x));
            assert_eq!(of(Measure::Reading(r, RayAverage::USpread))[k], log10(expected) + deviation.log10(), "{name}");
        }
    }
    // Counts are those of the field, between none and all.
    let [per_root, per_ray] = [Baseline::WeightsSpreadPerRootRay, Baseline::WeightsSpreadPerRay].map(baseline);
    let counts: Vec<f64> = per_root.iter().zip(per_ray).map(|(root, ray)| (root / ray).powi(2)).collect();
    assert!(counts.iter().all(|c| (0.49..4097.0).contains(c)) && counts.iter().any(|c| *c > 1.0));
    // The random baseline differs between views but repeats for one seed.
    let random = measures.iter().position(|m| *m == Measure::Baseline(Baseline::Random)).unwrap();
    assert_eq!(baseline(Baseline::Random), &evaluator.evaluate(&truth, 7, &Silent).unwrap().measures[random]);
    assert_ne!(baseline(Baseline::Random), &evaluator.evaluate(&truth, 8, &Silent).unwrap().measures[random]);
}

#[test]
fn a_measure_that_is_the_error_has_no_area() {
    let ball = ClosedForm::ball();
    let model = renderer(&ball);
    let evaluator = Evaluator::new(&model, &[]);
    let truth = truth(&ball, &cameras()[0]);
    let mut view = evaluator.evaluate(&truth, 0, &Silent).unwrap();
    view.measures = vec![view.absolute_error.clone(), view.absolute_error.iter().map(|e| -e).collect()];
    let views = [view.clone(), view];
    let [best, worst] = [0, 1].map(|m| Score::new(&views, m).unwrap());
    for (i, kind) in ErrorKind::ALL.into_iter().enumerate() {
        let [best, worst] = [&best, &worst].map(|score| score.curves[i].area);
        assert!(best == 0.0 && worst > 0.2, "{kind:?}");
        let all = |values: &dyn Fn(&EvaluatedView) -> Vec<f64>| views.iter().flat_map(values).collect::<Vec<_>>();
        let [measure, error] = [all(&|v| v.measures[1].clone()), all(&|v| v.absolute_error.clone())];
        let expected = sparsification(&measure, &error, kind).unwrap().area;
        assert_eq!(worst, expected);
    }
    assert!(worst.ause_pooled.mae != worst.ause_pooled.rmse);
    let depth = DepthError::new(&views).unwrap();
    let errors = &views[0].absolute_error;
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!((depth.mean - mean).abs() < 1e-12 && depth.median < depth.percentile_95);
}

#[test]
fn clean_up_removes_nothing_above_the_prior_and_everything_below_the_least() {
    let ball = ClosedForm::ball();
    let field = uncertainty(&ball);
    let mut truths: Vec<TrueView> = cameras().iter().map(|camera| truth(&ball, camera)).collect();
    // What is shown where nothing should be does not count as covered.
    for truth in &mut truths {
        let covered = truth.covered.iter_mut().filter(|c| **c);
        covered.take(20).for_each(|c| *c = false);
    }
    let edge = ball.bounds().longest_edge();
    let share = |u: f64| (u / edge).log10() / SCALE;
    let lowest = field.deviations().iter().fold(f64::INFINITY, f64::min);
    let [all, none] = [share(field.prior()) + 1e-9, share(lowest) - 1e-9];
    let middle = 0.5 * (all + none);
    let cleaned =
        clean_up(&ball, &renderer(&ball), &BakedField::unbaked(&field), &truths, &[none, middle, all], &Silent)
            .unwrap();
    let [before, gone, some, kept] = [0, 1, 2, 3].map(|k| &cleaned[k]);
    assert!(before.0.psnr == f64::INFINITY && before.0.ssim > 1.0 - 1e-9 && before.0.coverage == 1.0);
    for (a, b) in before.1.iter().zip(&kept.1) {
        assert_eq!(a.pixels, b.pixels);
    }
    assert!(gone.1.iter().flat_map(|view| &view.pixels).all(|p| p.opacity == 0.0 && p.color == DVec3::ONE));
    assert!(gone.0.coverage == 0.0 && gone.0.psnr_shown.is_nan() && gone.0.psnr < 20.0);
    assert!(some.0.coverage < 1.0 && some.0.psnr > gone.0.psnr, "{some:?}");
    // The threshold in scene units follows from its share of the scale.
    assert!((10_f64.powf(kept.0.log10.unwrap()) / field.prior() - 1.0).abs() < 1e-7);
    // What stays of the visible surfaces, which are among what the field is most certain of.
    assert_eq!([before.0.surfaces, gone.0.surfaces, kept.0.surfaces], [None, Some(0.0), Some(1.0)]);
    assert!(some.0.surfaces.is_some_and(|share| share > 0.0));
}
