//! The demo's model: a hash grid, trained on the spot on pictures of a built-in scene.

use glam::{DVec3, Vec3};

use crate::Result;
use crate::cli::progress::Bars;
use crate::dataset::PosedImage;
use crate::estimate::RaySettings;
use crate::field::{HashGrid, HashGridConfig, RadianceField};
use crate::geometry::{Camera, Domain};
use crate::monitor::Monitor;
use crate::render::render_view;
use crate::train::{Budget, Quality, Run, Shot, TrainSettings, Trainer, quality};

/// Entries per level, as a power of two. Half a megabyte of parameters is enough for pictures of 100 × 100.
const LOG2_HASHMAP_SIZE: u32 = 12;
/// Training steps. The number is fixed, so the demo shows the same on every machine.
const STEPS: u64 = 400;
/// Side of the training pictures, pixels.
const RESOLUTION: u32 = 100;

/// A model, and how well it shows what it was not trained on.
pub struct DemoModel {
    /// The model.
    pub field: HashGrid,
    /// Quality on pictures from between the training cameras.
    pub held_out: Option<Quality>,
}

/// Trains on what `cameras` see of `scene`. Every eighth picture is held out.
pub fn train(scene: &dyn RadianceField, cameras: &[Camera], bars: &Bars) -> Result<DemoModel> {
    let cameras: Vec<Camera> = cameras.iter().map(|camera| camera.resized([RESOLUTION; 2])).collect();
    let (mut train, mut held_out) = (Vec::new(), Vec::new());
    bars.begin("pictures", cameras.len() as u64 * u64::from(RESOLUTION));
    for (i, shot) in shots(scene, &cameras, bars)?.into_iter().enumerate() {
        if i % 8 == 4 { held_out.push(shot) } else { train.push(shot) }
    }
    bars.end();
    let config = HashGridConfig { log2_hashmap_size: LOG2_HASHMAP_SIZE, ..HashGridConfig::default() };
    let settings = TrainSettings { config, ..TrainSettings::default() };
    let mut trainer = Trainer::new(settings, Domain::Box(scene.bounds()), &train)?;
    bars.begin("steps", STEPS);
    let run = Run { budget: Budget::Steps(STEPS), held_out: &[], pixels: 0, looks: 0, state: None };
    let mut done = 0;
    let finished = run.train(&mut trainer, 0.0, bars, |progress| {
        bars.advance(progress.steps - done);
        done = progress.steps;
    })?;
    bars.end();
    if finished.interrupted {
        return Err(crate::Error::Interrupted);
    }
    let about = serde_json::json!({ "source": scene.describe(), "images": train.len(), "steps": STEPS });
    let field = trainer.field(about);
    let held_out = quality(&field, &held_out, Vec3::ONE, 20_000);
    Ok(DemoModel { field, held_out })
}

/// What `cameras` see of `scene`, as pictures with alpha.
fn shots(scene: &dyn RadianceField, cameras: &[Camera], bars: &Bars) -> Result<Vec<Shot>> {
    let settings = RaySettings { cutoff: 1e-4, background: Vec3::ZERO, ..RaySettings::default() };
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
        Ok(Shot { name: format!("train/r_{i}"), camera: *camera, image })
    };
    cameras.iter().enumerate().map(shot).collect()
}
