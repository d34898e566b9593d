//! Splats of lego, trained on 100, 12 and 10 views: what √(gᵀCg) is worth for the depth of new views.

use glam::{DMat3, DVec3, Vec3};
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::render::{DepthSample, DepthVariance, RaySamples, Renderer};
use octobayes_data::{DepthEncoding, DepthKind, Frame, Views};
use octobayes_evaluation::metrics::{ErrorKind, sparsification, spearman};
use octobayes_evaluation::{DepthMeaning, TrueView};
use octobayes_splats::{SplatRenderer, Splats};
use std::collections::HashMap;

use super::data;

/// A block for each splat, as if its neighbours did not move with it.
struct Blocks {
    /// By the bits of the centre: Σ JᵀJ.
    sums: HashMap<[u32; 3], DMat3>,
    scale: f64,
    lambda: f64,
}

impl Blocks {
    fn add(&mut self, batches: &[RaySamples]) {
        for batch in batches {
            for (x, jacobian) in batch.positions.iter().zip(&batch.jacobians) {
                let sum = self.sums.entry(x.to_array().map(f32::to_bits)).or_insert(DMat3::ZERO);
                for row in jacobian.chunks(3) {
                    let row = DVec3::from_slice(&row.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>());
                    *sum += DMat3::from_cols(row.x * row, row.y * row, row.z * row);
                }
            }
        }
    }
}

impl DepthVariance for Blocks {
    fn variance(&self, samples: &[DepthSample]) -> f64 {
        let of = |sample: &DepthSample| {
            let sum = self.sums.get(&sample.position.to_array().map(f32::to_bits)).copied().unwrap_or(DMat3::ZERO);
            let h = self.scale * sum + 2.0 * self.lambda * DMat3::IDENTITY;
            sample.gradient.dot(h.inverse() * sample.gradient)
        };
        samples.iter().map(of).sum()
    }
}

/// True if the pixel and its eight neighbours show matter of known depth.
fn is_within(truth: &TrueView, i: usize) -> bool {
    let [width, height] = truth.camera.resolution.map(|side| side as usize);
    let (x, y) = (i % width, i / width);
    (1..width - 1).contains(&x)
        && (1..height - 1).contains(&y)
        && (y - 1..=y + 1).all(|y| (x - 1..=x + 1).all(|x| truth.distance[y * width + x].is_some()))
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/splats-trained and nerf-lego-400"]
fn depth_of_new_views_is_ranked() {
    // Model, and what its area was, rounded up. Every second pixel of the 400 px images is compared, not their means.
    for (name, most) in [("lego_15k_sh3", 0.26), ("lego_half12_6k_sh2", 0.19), ("lego_10views_5k_sh2", 0.28)] {
        let splats = Splats::read(&data(&format!("splats-trained/{name}.ply"))).unwrap();
        let cameras: Vec<Camera> =
            Views::read(&data(&format!("splats-trained/{name}_transforms.json")), None).unwrap().cameras();
        let bounds = Aabb::centered_cube(1.4);
        let pixels = cameras.iter().map(Camera::pixels).sum();
        let prior = DataScale::default_prior_deviation(&Domain::Box(bounds));
        let scale = DataScale::new(pixels, 0.03, prior).unwrap();
        let rays = 1_000_000;
        let start = std::time::Instant::now();
        let grid = GridSettings::default().level(6).covariance(Covariance::Block).scale(Scale::Data(scale));
        let mut blocks = Blocks { sums: HashMap::new(), scale: 1.0, lambda: scale.lambda() };
        let run = Estimation::new(&splats, &cameras).domain(Domain::Box(bounds)).grid(grid);
        let run = run.rays(RaySettings::default().rays(rays)).tap(|batches| {
            blocks.add(batches);
            Ok(())
        });
        let field = run.run().unwrap().field;
        let seconds = start.elapsed().as_secs_f64();
        blocks.scale = 2.0 / rays as f64;
        let posterior = field.depth_posterior().unwrap();

        let views = Views::read(&data("nerf-lego-400/transforms_test.json"), None).unwrap();
        let encoding = DepthEncoding { offset: 8.0, scale: -8.0, kind: DepthKind::Euclidean };
        let renderer = SplatRenderer::new(&splats, Vec3::ONE);
        let (mut errors, mut field_deviation, mut block_deviation) = (Vec::new(), Vec::new(), Vec::new());
        let (mut spread, mut opacity, mut quality) = (Vec::new(), Vec::new(), Vec::new());
        for frame in views.frames.iter().step_by(2) {
            let map = data(&format!("nerf-lego-400/{}_depth_0001.png", frame.name.trim_start_matches("./")));
            let frame = Frame { depth: Some(map), ..frame.clone() };
            let meaning = DepthMeaning { encoding, bounds, jump: 0.0 };
            let truth = TrueView::read(&frame, Some(&meaning), DVec3::ONE, 0.5, 2).unwrap();
            let view = renderer.image(&truth.camera, 0.5, &[], &[&posterior, &blocks], &Silent).unwrap();
            quality.push(psnr(&view.pixels.iter().map(|p| p.color).collect::<Vec<_>>(), &truth.colors));
            for (i, pixel) in view.pixels.iter().enumerate().filter(|(i, p)| is_within(&truth, *i) && p.opacity > 0.0) {
                errors.push((pixel.expected_depth - truth.distance[i].unwrap()).abs());
                field_deviation.push(view.posterior_variance[0][i].sqrt());
                block_deviation.push(view.posterior_variance[1][i].sqrt());
                spread.push(pixel.depth_variance);
                opacity.push(1.0 - pixel.opacity);
            }
        }
        let area = |measure: &[f64]| {
            let area = sparsification(measure, &errors, ErrorKind::Mae).unwrap().area;
            (area, spearman(measure, &errors).unwrap())
        };
        let (ours, of_blocks) = (area(&field_deviation), area(&block_deviation));
        println!(
            "{name}: {} pixels, {:.1} dB, run of {rays} rays {seconds:.1} s; AUSE and rank correlation: level 6 \
             {ours:.3?}, blocks {of_blocks:.3?}, weights {:.3?}, 1 - opacity {:.3?}; median of error / deviation {:.1}",
            errors.len(),
            quality.iter().sum::<f64>() / quality.len() as f64,
            area(&spread),
            area(&opacity),
            {
                let mut ratios: Vec<f64> = errors.iter().zip(&field_deviation).map(|(e, s)| e / s).collect();
                ratios.sort_unstable_by(f64::total_cmp);
                ratios[ratios.len() / 2]
            },
        );
        assert!(ours.0 <= most && ours.0 < of_blocks.0, "{name}: {ours:?} against {of_blocks:?}");
    }
}
