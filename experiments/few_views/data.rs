//! The scenes' images and depth maps, made or converted once.

use std::path::{Path, PathBuf};

use octobayes::dataset::{DepthEncoding, DepthKind, Frame, Views};
use octobayes::evaluate::DepthFiles;
use octobayes::geometry::Camera;
use octobayes::monitor::Silent;
use octobayes::synth::{DEPTH_PNG_SCALE, DatasetSettings, Up, write_dataset};
use octobayes::train::{DatasetFiles, Shot};
use octobayes::{Error, Result};

use crate::common::kitchen::kitchen;
use crate::common::knot::knot;
use crate::common::program::Program;
use crate::plan::{Data, Plan, Scene};

/// What a scene's model is trained on and judged by.
pub struct Dataset {
    /// Training images.
    pub train: Vec<Shot>,
    /// Frames with true depth.
    pub test: Vec<Frame>,
    pub depth: DepthFiles,
    /// The box.
    pub files: DatasetFiles,
}

impl Dataset {
    /// Opens the scene's data, making it first if it is not there.
    pub fn open(scene: &Scene, plan: &Plan, work: &Path) -> Result<Self> {
        let synthetic = |mesh: &Path, name: &str, up| -> Result<(PathBuf, DepthFiles)> {
            let folder = work.join(format!("data-{name}"));
            if !folder.exists() {
                let settings = DatasetSettings::default()
                    .up(up)
                    .views(plan.train_views)
                    .test_views(plan.test_views)
                    .resolution([plan.resolution; 2])
                    .samples_per_side(plan.samples_per_side);
                write_dataset(mesh, &folder, &settings, &Silent)?;
            }
            Ok((folder.clone(), depth_of(folder.join("depth"), "{}.png", [0.0, DEPTH_PNG_SCALE], DepthKind::Euclidean)))
        };
        let (folder, depth) = match scene.data {
            Data::Lego => {
                let folder = Program::data()?.join("nerf-lego-400");
                let depth = depth_of(folder.join("test"), "{}_depth_0001.png", [8.0, -8.0], DepthKind::Euclidean);
                (folder, depth)
            }
            Data::Mesh(name, up) => synthetic(&Program::data()?.join(format!("meshes/{name}.obj")), name, up)?,
            Data::Knot => {
                let mesh = work.join("knot.obj");
                std::fs::write(&mesh, knot()).map_err(Error::io(&mesh, "cannot write"))?;
                synthetic(&mesh, "knot", Up::Z)?
            }
            Data::Kitchen => {
                let folder = work.join("data-kitchen");
                let depth = kitchen(&folder)?;
                (folder, depth)
            }
        };
        let mut files = DatasetFiles::read(&folder)?;
        files.select(&scene.views, scene.half)?;
        let [train, _] = files.load(&Silent)?;
        let test = Views::read(&folder.join("transforms_test.json"), None)?.frames;
        Ok(Self { train, test, depth, files })
    }

    /// Training cameras.
    pub fn cameras(&self) -> Vec<Camera> {
        self.train.iter().map(|shot| shot.camera).collect()
    }
}

fn depth_of(folder: PathBuf, pattern: &str, [offset, scale]: [f64; 2], kind: DepthKind) -> DepthFiles {
    DepthFiles { folder, pattern: pattern.into(), encoding: DepthEncoding { offset, scale, kind } }
}
