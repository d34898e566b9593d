//! The scenes' images, made or converted.

use std::path::Path;

use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::{Frame, Views};
use octobayes_synth::{DatasetSettings, Up, write_dataset};
use octobayes_train::{DatasetFiles, Shot};

use crate::scene::Scene;
use common::kitchen::kitchen;
use common::knot::knot;
use common::program::Program;

/// Pixels along the sides of images that `synth` makes, and their samples.
pub const SIDE: u32 = 200;
const SAMPLES_PER_SIDE: u32 = 3;
const TRAINING_VIEWS: u32 = 40;
const TEST_VIEWS: u32 = 16;

/// Where a scene's images come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Data {
    /// NeRF-synthetic lego, 400 × 400.
    Lego,
    /// A mesh of the data folder, ray-traced by `synth`.
    Mesh(&'static str, Up),
    /// A knot that this program makes, ray-traced by `synth`.
    Knot,
    /// RGB-D frames of a kitchen, 320 × 240.
    Kitchen,
}

impl Data {
    /// Whether pictures may show the data set's own images: those of others are not this project's to give away.
    pub fn has_own_images(self) -> bool {
        matches!(self, Self::Mesh(..) | Self::Knot)
    }

    /// Whether pictures may show it at all: the terms of the scan of nefertiti (CC-BY-NC-SA) would hold for them.
    pub fn may_be_pictured(self) -> bool {
        !matches!(self, Self::Mesh("nefertiti", _))
    }
}

/// What a scene's model is trained on and judged by.
pub struct Dataset {
    pub training: Vec<Shot>,
    /// Held-out frames.
    pub test: Vec<Frame>,
    /// The box.
    pub files: DatasetFiles,
}

impl Dataset {
    /// Opens the scene's data. What is made for it goes into `folder`.
    pub fn open(scene: &Scene, folder: &Path) -> Result<Self> {
        let made = &folder.join("data");
        let synthetic = |mesh: &Path, up| -> Result<()> {
            let settings = DatasetSettings::default()
                .up(up)
                .views(TRAINING_VIEWS)
                .test_views(TEST_VIEWS)
                .resolution([SIDE; 2])
                .samples_per_side(SAMPLES_PER_SIDE);
            write_dataset(mesh, made, &settings, &Silent)
        };
        let folder = match scene.data {
            Data::Lego => &Program::data()?.join("nerf-lego-400"),
            Data::Mesh(name, up) => {
                synthetic(&Program::data()?.join(format!("meshes/{name}.obj")), up)?;
                made
            }
            Data::Knot => {
                let mesh = folder.join("knot.obj");
                std::fs::write(&mesh, knot()).map_err(Error::io(&mesh, "cannot write"))?;
                synthetic(&mesh, Up::Z)?;
                made
            }
            Data::Kitchen => {
                kitchen(made)?;
                made
            }
        };
        let mut files = DatasetFiles::read(folder)?;
        files.select(&scene.views, scene.half)?;
        let [training, _] = files.load(&Silent)?;
        let test = Views::read(&folder.join("transforms_test.json"), None)?.frames;
        Ok(Self { training, test, files })
    }

    /// Training cameras.
    pub fn cameras(&self) -> Vec<Camera> {
        self.training.iter().map(|shot| shot.camera).collect()
    }
}
