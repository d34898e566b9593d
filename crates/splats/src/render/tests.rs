//! The fast images and their derivatives, against the slow ones.

mod data;

use glam::{DVec3, Quat, Vec3};
use rand::rngs::ChaCha8Rng;
use rand::{Rng, SeedableRng};

use super::reference::{Gaussian, gaussians, shown};
use super::*;
use crate::RenderMode;
use octobayes::render::{RaySamples, Renderer};

/// A number in [0, 1).
fn share(rng: &mut ChaCha8Rng) -> f32 {
    (rng.next_u32() >> 8) as f32 / (1 << 24) as f32
}

/// A cloud of `n` splats of all shapes in the cube [-1, 1]³, some opaque, with colours of `degree`.
pub fn cloud(n: usize, degree: u8, mode: RenderMode) -> Splats {
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let mut number = |low: f32, high: f32| low + (high - low) * share(&mut rng);
    let coefficients = 3 * (usize::from(degree) + 1).pow(2);
    let (mut means, mut scales, mut rotations, mut opacities, mut sh) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for _ in 0..n {
        means.push(Vec3::from_array(std::array::from_fn(|_| number(-1.0, 1.0))));
        scales.push(Vec3::from_array(std::array::from_fn(|_| number(-5.0, -1.5))));
        let q: [f32; 4] = std::array::from_fn(|_| number(-1.0, 1.0));
        rotations.push(Quat::from_array(q).normalize());
        opacities.push(number(-3.0, 6.0));
        sh.extend((0..coefficients).map(|k| number(-1.0, 1.0) / if k < 3 { 1.0 } else { 4.0 }));
    }
    Splats::new(means, scales, rotations, opacities, sh, degree, mode).unwrap()
}

/// A camera near the cloud, so that some splats lie beside and behind the image.
pub fn near() -> Camera {
    Camera::look_at(DVec3::new(1.6, -1.1, 0.7), DVec3::new(0.1, 0.0, 0.2), DVec3::Z, 1.2, [60, 44])
}

const BACKGROUND: Vec3 = Vec3::new(0.2, 1.0, 0.6);

fn background() -> [f64; 3] {
    BACKGROUND.to_array().map(f64::from)
}

/// Centres along the axis at ½ of the nearest distance drawn, at twice it, and three that no count has: behind, beside
/// the image near and far.
#[test]
fn splats_in_front_of_the_nearest_plane_are_counted() {
    let camera = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 1.0, [40, 40]);
    let near = NEAR as f32;
    let means =
        [[0.5 * near, 0.0, 0.0], [2.0 * near, 0.0, 0.0], [-near, 0.0, 0.0], [0.5 * near, near, 0.0], [1.0, 1.0, 0.0]];
    let n = means.len();
    let means = means.map(Vec3::from_array).to_vec();
    let at = |means: Vec<Vec3>| {
        let (scales, turns) = (vec![Vec3::splat(-4.0); n], vec![Quat::IDENTITY; n]);
        Splats::new(means, scales, turns, vec![1.0; n], vec![0.0; 3 * n], 0, RenderMode::Classic).unwrap()
    };
    assert_eq!(share_too_near(&at(means.clone()), &[camera]), 0.5);
    let away = means.iter().map(|x| *x + 3.0 * Vec3::X).collect();
    assert_eq!(share_too_near(&at(away), &[camera]), 0.0);
}

#[test]
fn images_are_those_of_the_reference() {
    for mode in RenderMode::ALL {
        let splats = cloud(600, 3, mode);
        let (camera, slow) = (near(), gaussians(&splats));
        let renderer = SplatRenderer::new(&splats, BACKGROUND);
        let view = renderer.image(&camera, 0.5, &[], &octobayes::monitor::Silent).unwrap();
        let (mut covered, mut most) = (0, 0.0_f64);
        for (i, pixel) in view.pixels.iter().enumerate() {
            let at = [(i % 60) as f64 + 0.5, (i / 60) as f64 + 0.5];
            let expected = shown(&slow, mode, &camera, background(), at);
            covered += usize::from(expected.opacity > 0.5);
            let away = (0..3).map(|k| (pixel.color[k] - expected.color[k]).abs()).fold(0.0, f64::max);
            most = most.max(away).max((pixel.opacity - expected.opacity).abs());
            if expected.opacity > 0.01 {
                let axis = -camera.axes.z_axis;
                let depth = pixel.expected_depth * camera.ray(at[0], at[1]).direction.dot(axis);
                assert!((depth - expected.depth).abs() < 1e-9 * depth, "{depth} against {}", expected.depth);
            }
        }
        assert!(covered > 1000, "{covered} pixels show anything");
        // Colours of splats are rounded to f32, those of pixels are not.
        assert!(most < 2e-7, "{mode}: {most:e}");
    }
}

/// Largest difference from central differences, relative to the largest entry of its pixel; number of entries that were
/// compared, and of those whose list of hits changes in between.
#[derive(Debug, Default)]
pub struct Compared {
    pub worst: f64,
    pub entries: usize,
    pub changed: usize,
}

/// Compares G at every `stride`-th pixel with central differences of the reference.
pub fn compare_derivatives(splats: &Splats, camera: &Camera, stride: usize) -> Compared {
    // The mean of h² f''' and of rounding, 1e-16 / h, at lengths of 1.
    const H: f64 = 2e-6;
    let (mode, slow) = (splats.mode(), gaussians(splats));
    let renderer = SplatRenderer::new(splats, BACKGROUND);
    let view = renderer.prepare(camera, Outputs::Derivatives);
    let mut of = Compared::default();
    let (mut hits, width) = (Hits::default(), camera.resolution[0] as usize);
    for i in (0..camera.pixels() as usize).step_by(stride) {
        let at = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
        let mut samples = RaySamples::default();
        view.push_samples(at, 0, &mut hits, &mut samples);
        let here = shown(&slow, mode, camera, background(), at);
        let order: Vec<usize> = hits.list.iter().map(|hit| view.splat(hit)).collect();
        assert_eq!(order, here.hits.iter().map(|(splat, _)| *splat).collect::<Vec<_>>());
        let scale = samples.jacobians.iter().flatten().fold(0.0_f64, |most, v| most.max(f64::from(v.abs())));
        for (n, &splat) in order.iter().enumerate() {
            for axis in 0..3 {
                let moved = |by: f64| {
                    let mut others: Vec<Gaussian> = slow.clone();
                    others[splat].mean[axis] += by;
                    shown(&others, mode, camera, background(), at)
                };
                let [up, down] = [moved(H), moved(-H)];
                if up.hits != here.hits || down.hits != here.hits {
                    of.changed += 1;
                    continue;
                }
                for channel in 0..3 {
                    let numeric = (up.color[channel] - down.color[channel]) / (2.0 * H);
                    let found = f64::from(samples.jacobians[n][3 * channel + axis]);
                    of.worst = of.worst.max((numeric - found).abs() / scale);
                    of.entries += 1;
                }
            }
        }
    }
    of
}

#[test]
fn derivatives_are_those_of_the_reference() {
    for mode in RenderMode::ALL {
        let color = compare_derivatives(&cloud(150, 3, mode), &near(), 53);
        println!("{mode}: {color:?}");
        assert!(color.entries > 1000 && color.changed < color.entries / 50, "{color:?}");
        assert!(color.worst < 1e-6, "{mode}: {color:?}");
    }
}

#[test]
fn a_splat_moved_along_the_ray_through_its_centre_stays_on_its_pixel() {
    // Off the axis: the motion on the image, ∂m/∂μ, has the ray as its kernel; what is left is the ellipse's growth.
    let splats = cloud(1, 0, RenderMode::Classic);
    let camera = near();
    let view = SplatRenderer::new(&splats, BACKGROUND).prepare(&camera, Outputs::Derivatives);
    let ([x, y], _) = camera.project(splats.mean(0).as_dvec3()).unwrap();
    let (mut hits, mut samples) = (Hits::default(), RaySamples::default());
    view.push_samples([x, y], 7, &mut hits, &mut samples);
    // At the centre v = 0, so that α is at its maximum: no displacement changes the pixel to first order.
    assert_eq!((samples.rays.as_slice(), samples.positions.len()), (&[7][..], 1));
    let most = samples.jacobians[0].iter().fold(0.0_f32, |most, v| most.max(v.abs()));
    assert!(most < 1e-5, "{most:e}");
    assert!((samples.sight[0].until - splats.mean(0).as_dvec3().distance(camera.position)).abs() < 1e-6);
}

#[test]
fn lenses_that_distort_are_refused() {
    let mut camera = near();
    assert!(SplatRenderer::check_cameras([&camera]).is_ok());
    camera.distortion.k[0] = 0.1;
    let error = SplatRenderer::check_cameras([&near(), &camera]).unwrap_err().to_string();
    assert!(error.contains("undistorted"), "{error}");
}
