//! Splats under the same judge: their measures against the slow images, every pixel and every vertex evaluated.

use glam::{DVec3, Quat, Vec3};

use super::*;
use octobayes::estimate::GridKind;
use octobayes::estimate::Model;
use octobayes::geometry::Domain;
use octobayes::posterior::{DataScale, Scale};
use octobayes_splats::reference::{Gaussian, Shown, gaussians, shown};
use octobayes_splats::{RenderMode, SplatRenderer, Splats};

const LEVEL: u8 = 3;
const STRIDE: u32 = 3;

/// A shell of splats of several opacities, and a few within.
fn shell() -> Splats {
    let count = 140;
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    Splats::new(
        (0..count).map(|i| normal(i) * if i % 9 == 0 { 0.3 } else { 0.7 }).collect(),
        vec![Vec3::new(-2.2, -2.4, -3.4); count],
        (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
        (0..count).map(|i| -1.0 + (i % 5) as f32).collect(),
        (0..3 * count).map(|k| ((k * 7) % 11) as f32 / 5.0 - 1.0).collect(),
        0,
        RenderMode::Classic,
    )
    .unwrap()
}

fn from(angle: f64) -> Camera {
    let eye = DVec3::new(2.4 * angle.cos(), 2.4 * angle.sin(), 0.6);
    Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [40, 34])
}

/// The field of three cameras on one side, on every vertex of a grid.
fn field_of(splats: &Splats) -> UncertaintyField {
    let domain = Domain::Box(Aabb::centered_cube(1.0));
    let scale = DataScale::new(3 * 40 * 34, 0.03, DataScale::default_prior_deviation(&domain)).unwrap();
    let grid = GridSettings::default().grid(GridKind::Dense).level(LEVEL).covariance(Covariance::Block);
    let cameras = [0.0, 0.4, 0.8].map(from);
    Estimation::new(splats, &cameras)
        .domain(domain)
        .rays(RaySettings::default().rays(4000))
        .grid(grid.scale(Scale::Data(scale)).keep_sums(true))
        .run()
        .unwrap()
        .field
}

/// What is shown of a pixel by all hits before each, then by all: their opacities.
fn opacities(slow: &[Gaussian], camera: &Camera, at: [f64; 2], here: &Shown) -> Vec<f64> {
    let first = |n: usize| -> Vec<Gaussian> { here.hits[..n].iter().map(|(splat, _)| slow[*splat].clone()).collect() };
    let opacity =
        |n: usize| if n == 0 { 0.0 } else { shown(&first(n), RenderMode::Classic, camera, [1.0; 3], at).opacity };
    (0..=here.hits.len()).map(opacity).collect()
}

#[test]
fn measures_of_splats_are_those_of_the_slow_images() {
    let splats = shell();
    let (field, slow) = (field_of(&splats), gaussians(&splats));
    let readings = [Reading { name: "U".into(), field: field.clone(), averages: vec![RayAverage::USpread] }];
    let model = SplatRenderer::new(&splats, Vec3::ONE);
    let camera = from(1.3);
    let strided = camera.strided(STRIDE, 0.5);
    let n = strided.pixels() as usize;
    let truth = TrueView {
        name: "view".into(),
        camera: strided,
        whole: camera,
        stride: STRIDE,
        pixel_offset: 0.5,
        colors: vec![DVec3::ONE; n],
        kept: vec![true; n],
        covered: vec![true; n],
        distance: vec![Some(2.0); n],
        readings: DepthReadings::default(),
        parts: TrueParts::default(),
    };
    let evaluator = Evaluator::new(&model, &readings);
    let view = evaluator.evaluate(&truth, 0, &Silent).unwrap();
    let measures = evaluator.measures();
    let of = |measure| &view.measures[measures.iter().position(|m| *m == measure).unwrap()];
    let forward = -camera.axes.z_axis;
    let mut compared = 0;
    for (k, &i) in view.pixels.iter().enumerate() {
        // The pixels are those of the whole image, not of a smaller one in which splats would grow by more.
        let [x, y] = [i % strided.resolution[0] as usize, i / strided.resolution[0] as usize];
        let at = [x, y].map(|n| (n * STRIDE as usize) as f64 + 0.5);
        let ray = camera.ray(at[0], at[1]);
        let slant = ray.direction.dot(forward);
        let here = shown(&slow, RenderMode::Classic, &camera, [1.0; 3], at);
        let pixel = view.rendered.pixels[i];
        assert!((pixel.opacity - here.opacity).abs() < 1e-7, "{} against {}", pixel.opacity, here.opacity);
        assert!((pixel.expected_depth - here.depth / slant).abs() < 1e-8, "{pixel:?} against {here:?}");

        // The spread of the weights, and the depth in their middle.
        let opacities = opacities(&slow, &camera, at, &here);
        let weights: Vec<f64> = opacities.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let depth = |splat: usize| (splats.mean(splat).as_dvec3() - camera.position).dot(forward) / slant;
        let depths: Vec<f64> = here.hits.iter().map(|(splat, _)| depth(*splat)).collect();
        let mean = |value: &dyn Fn(usize) -> f64| {
            weights.iter().enumerate().map(|(j, w)| w * value(j)).sum::<f64>() / here.opacity
        };
        let variance = mean(&|j| (depths[j] - here.depth / slant).powi(2));
        let within = mean(&|j| {
            let splat = here.hits[j].0;
            let axis = splats.rotation(splat).inverse().mul_vec3(forward.as_vec3()) * splats.scale(splat);
            f64::from(axis.length_squared()) / (slant * slant)
        });
        assert!((of(Measure::Baseline(Baseline::RayVariance))[k] - variance).abs() < 1e-7);
        // Shapes of splats are f32.
        assert!((view.spread[k].powi(2) - variance - within).abs() < 1e-5 * (variance + within));
        let middle = (0..weights.len()).find(|&j| opacities[j + 1] >= 0.5 * here.opacity).unwrap();
        let error = (depths[middle] - 2.0).abs();
        assert!((view.absolute_error[k] - error).abs() < 1e-6, "{} against {error}", view.absolute_error[k]);

        // Beside the box of all centres there is nothing to ask about.
        let x = model.bounds().clamp(ray.at(pixel.expected_depth).as_vec3());
        assert_eq!(of(Measure::Reading(0, RayAverage::USpread))[k], field.log10(x) + view.spread[k].log10());
        // 0.85 √(s U′), where cells are 2 / 2³ wide, and half a pixel.
        let u = field.query(x).uncertainty * (200.0 * 0.25 / pixel.median_depth).powf(1.5);
        let half = 0.5 * pixel.median_depth / camera.focal[0];
        let deviation = (0.85 * (view.spread[k] * u).sqrt()).hypot(half);
        let found = of(Measure::DepthDeviation(0))[k];
        assert!((found / deviation - 1.0).abs() < 1e-6, "{found} instead of {deviation}");
        compared += 1;
    }
    assert!(compared > 50, "{compared} pixels compared");
}

#[test]
fn training_views_of_splats_see_the_side_that_faces_them() {
    let splats = shell();
    let model = SplatRenderer::new(&splats, Vec3::ONE);
    // More pixels than are kept of an image: some of them are taken, and splats stay as large as they are.
    let camera = |angle| from(angle).resized([300, 255]);
    let views = TrainingViews::render(&model, &[0.0, 0.5].map(camera), 0.5, &Silent).unwrap();
    let towards = |angle: f64| 0.7 * DVec3::new(angle.cos(), angle.sin(), 0.0);
    assert_eq!(views.sighting(towards(0.25)).views, 2);
    assert_eq!(views.sighting(towards(3.4)).views, 0);
}

#[test]
fn splats_are_cleaned_up_as_volumes_are() {
    let splats = shell();
    let field = field_of(&splats);
    let model = SplatRenderer::new(&splats, Vec3::ONE);
    let camera = from(0.6);
    let view = model.image(&camera, 0.5, &[], &Silent).unwrap();
    let n = view.pixels.len();
    let truth = TrueView {
        name: "view".into(),
        camera,
        whole: camera,
        stride: 1,
        pixel_offset: 0.5,
        colors: view.pixels.iter().map(|p| p.color).collect(),
        kept: vec![true; n],
        covered: view.pixels.iter().map(|p| p.opacity > 0.5).collect(),
        distance: vec![None; n],
        readings: DepthReadings::default(),
        parts: TrueParts::default(),
    };
    // From below the least U to above the prior. The unit is that of a share of 0.
    let cleaned = clean_up(&splats, &model, &BakedField::unbaked(&field), &[truth], &[-5.0, 1.0], &Silent).unwrap();
    let [before, gone, kept] = [0, 1, 2].map(|k| &cleaned[k]);
    assert_eq!((before.0.psnr, kept.0.psnr), (f64::INFINITY, f64::INFINITY));
    assert!(gone.1[0].pixels.len() == n && gone.0.coverage == 0.0 && gone.0.psnr < 25.0, "{:?}", gone.0);
    assert!(gone.1[0].pixels.iter().all(|p| p.color == DVec3::ONE && p.opacity == 0.0));
    // Half of the splats: the image shows those, and nothing else.
    let mut log10: Vec<f64> = splats.means().iter().map(|x| field.log10(*x)).collect();
    let kept: Vec<bool> = {
        let mut sorted = log10.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let middle = sorted[splats.len() / 2];
        log10.iter_mut().map(|u| *u <= middle).collect()
    };
    let middle = log10.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(u, _)| *u).fold(f64::MIN, f64::max);
    let expected = splats.clone().keep(&kept).unwrap();
    let expected = SplatRenderer::new(&expected, Vec3::ONE).image(&camera, 0.5, &[], &Silent).unwrap();
    let field = BakedField::unbaked(&field);
    let left = splats.certain_part(&field, middle).unwrap().unwrap();
    let found = left.like(&model).image(&camera, 0.5, &[], &Silent).unwrap();
    assert_eq!(found.pixels, expected.pixels);
}
