//! The demo's model: a hash grid, trained on the spot on pictures of a built-in scene.

use glam::{DVec3, Vec3};

use super::scene::{Truth, courtyard};
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::field::{RadianceField, TrainedField};
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Monitor;
use octobayes::posterior::DataScale;
use octobayes::render::render_view;
use octobayes_data::PosedImage;
use octobayes_models::{HashGrid, HashGridConfig};
use octobayes_train::{Budget, Quality, Run, Shot, TrainSettings, Trainer, quality};

/// Training steps. The number is fixed, so the demo shows the same on every machine.
const STEPS: u64 = 2000;
/// Side of the training pictures, pixels. In the middle of the scene a pixel is as wide as a cell of level 7.
const RESOLUTION: u32 = 160;
/// Pixels of these pictures on which the noise that training left is measured.
const NOISE_PIXELS: usize = 1 << 16;

/// Settings of training.
///
/// With 2^12 entries per level, matter and empty space share entries, and certain specks float in the air: they were
/// 0.05 % of what is visible, and none with 2^14. Levels finer than the scene's surfaces and no distortion loss leave
/// fog around surfaces, and twice as many vertices. With three times this distortion loss, one seed of four represented
/// the floor by matter below it, and clean-up removed 78 % of what was made up instead of 99 %.
fn settings(seed: u64) -> TrainSettings {
    let config = HashGridConfig::default().log2_hashmap_size(14).base_resolution(12).per_level_scale(1.4);
    TrainSettings::default().config(config).distortion(0.01).seed(seed)
}

/// A model, and how well it shows what it was not trained on.
pub struct DemoModel {
    /// The model.
    pub field: HashGrid,
    /// The scene that it was trained on.
    pub truth: Truth,
    /// Quality on pictures from between the training cameras.
    pub held_out: Option<Quality>,
}

/// Trains on pictures of the courtyard. Every eighth picture is held out.
pub fn train(seed: u64, bars: &dyn Monitor) -> Result<DemoModel> {
    let (scene, cameras) = courtyard(RESOLUTION);
    let (mut train, mut held_out) = (Vec::new(), Vec::new());
    bars.begin("pictures", cameras.len() as u64 * u64::from(RESOLUTION));
    for (i, shot) in shots(&scene, &cameras, bars)?.into_iter().enumerate() {
        if i % 8 == 4 { held_out.push(shot) } else { train.push(shot) }
    }
    bars.end();
    let mut trainer = Trainer::new(settings(seed), Domain::Box(scene.bounds()), &train)?;
    bars.begin("steps", STEPS);
    let run = Run { budget: Budget::Steps(STEPS), held_out: &[], pixels: 0, looks: 0, state: None };
    let mut done = 0;
    let finished = run.train(&mut trainer, 0.0, bars, |progress| {
        bars.advance(progress.steps - done);
        done = progress.steps;
    })?;
    bars.end();
    if finished.interrupted {
        return Err(octobayes::Error::Interrupted);
    }
    let field = trainer.field(serde_json::json!(null));
    // As `train` stores it, so that U can be a length.
    let noise = quality(&field, &train, Vec3::ONE, NOISE_PIXELS).map(|shown| DataScale::noise_of(shown.psnr));
    let field = field.with_training(serde_json::json!({
        "source": scene.describe(), "images": train.len(), "steps": STEPS, "training_noise": noise
    }));
    let quality = quality(&field, &held_out, Vec3::ONE, usize::MAX);
    let truth = Truth::new(scene, &cameras, held_out.iter().map(|shot| shot.camera).collect());
    Ok(DemoModel { field, truth, held_out: quality })
}

/// What `cameras` see of `scene`, as pictures with alpha.
fn shots(scene: &dyn TrainedField, cameras: &[Camera], bars: &dyn Monitor) -> Result<Vec<Shot>> {
    let settings = RaySettings::default().cutoff(1e-4).background(Vec3::ZERO);
    let tracer = settings.tracer(scene, 0.0, bars)?;
    let shot = |(i, camera): (usize, &Camera)| {
        let view = render_view(&tracer, camera, 0.5, &[], bars)?;
        let pixels = view.pixels.iter().map(|pixel| {
            // Over black, colour is already multiplied by alpha.
            let straight = pixel.color / pixel.opacity.max(1e-6);
            let byte = |v: f64| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
            let DVec3 { x, y, z } = straight;
            [x, y, z, pixel.opacity].map(byte)
        });
        let image = PosedImage::new(camera.resolution, pixels.collect());
        Ok(Shot { name: format!("train/r_{i}"), camera: *camera, image, mask: None })
    };
    cameras.iter().enumerate().map(shot).collect()
}
