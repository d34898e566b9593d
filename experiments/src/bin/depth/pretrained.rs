//! Models of lego that others trained, and voxels baked from one: the same study with nothing known of their training.

use glam::{DVec3, Vec3};
use octobayes::estimate::RaySettings;
use octobayes::field::{TrainedField, VoxelGrid};
use octobayes::metrics::psnr;
use octobayes::monitor::Silent;
use octobayes::render::{Tracer, render_view};
use octobayes::{Error, Result};
use octobayes_evaluation::TrueView;
use octobayes_train::Selection;

use crate::compared;
use crate::judge::{self, Row, grid, judge, uncertainties};
use crate::scene::{Data, TEST_VIEWS};
use common::clock::Clock;
use common::program::Program;
use common::scenes::Scene;
use common::settings::describe;
use common::table::mean;

/// Rays of each level: an MLP takes its time.
const RAYS: u64 = 240_000;
/// Every so many pixels of the images count where all of a mesh's would.
const STRIDE: u32 = 4;
/// Points of the voxel grid along an axis.
const VOXELS: usize = 256;

pub const NAMES: [&str; 3] = ["lego, Plenoptic PNG", "lego, voxels baked from it", "lego, MLP"];

fn model(name: &str) -> Result<Box<dyn TrainedField>> {
    let data = Program::data()?;
    let [png, voxels, mlp] = NAMES;
    Ok(match name {
        _ if name == png => Scene::lego(&data)?.field,
        // From above: what a voxel shows does not depend on the direction.
        _ if name == voxels => Box::new(VoxelGrid::bake(&*Scene::lego(&data)?.field, [VOXELS; 3], Vec3::NEG_Z)),
        _ if name == mlp => Scene::lego_mlp(&data)?.field,
        _ => return Err(Error::setting("model", NAMES.join(" | "), name)),
    })
}

fn rays() -> RaySettings {
    judge::rays().rays(RAYS)
}

pub fn settings() -> String {
    let (pixels, described) = (compared(STRIDE * judge::STRIDE), describe(&rays(), &grid(), &[]));
    format!("400 × 400 pixels; 100 training views; {pixels} of {TEST_VIEWS} held-out views. {described} Seed 0.")
}

/// Judges one of them.
pub fn measure(name: &str) -> Result<Row> {
    let (data, field) = (Data::lego(&Selection::All, STRIDE)?, model(name)?);
    let tracer = RaySettings::for_images().tracer(&*field, 0.0, &Silent)?;
    let images = data.images(field.pixel_offset());
    let (fields, summed) = uncertainties(&data, &*field, quality(&tracer, &images)?, rays())?;
    let clock = Clock::start();
    let mut row = judge(&data, &*field, None, &[], fields)?;
    row.seconds = [0.0, summed, clock.elapsed().cpu, 0.0];
    Ok(row)
}

/// Mean PSNR of images, dB.
fn quality(tracer: &Tracer, images: &[TrueView]) -> Result<f64> {
    let of = |image: &TrueView| {
        let view = render_view(tracer, &image.camera, image.pixel_offset, &[], &Silent)?;
        Ok(psnr(&view.pixels.iter().map(|pixel| pixel.color).collect::<Vec<DVec3>>(), &image.colors))
    };
    images.iter().map(of).collect::<Result<Vec<_>>>().map(|all| mean(&all))
}
