//! Scenes: images that may be taken, and held-out images with true depth.

use std::path::Path;

use glam::DVec3;
use octobayes::geometry::{Aabb, Camera};
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, PosedImage, Views};
use octobayes_evaluation::{DepthFiles, DepthMeaning, TrueView};
use octobayes_synth::{LitScene, Mesh, MeshScene, Up, viewpoints};
use octobayes_train::{DatasetFiles, Shot};
use rayon::prelude::*;

use crate::cup::cup;
use common::knot::knot;
use common::program::Program;

/// Width and height of the images that may be taken, pixels.
const SIDE: u32 = 200;
/// The same of held-out images.
const TEST_SIDE: u32 = 80;
/// Images that may be taken.
pub const VIEWS: u32 = 36;
/// Held-out images, all around.
const TEST_VIEWS: u32 = 10;
/// Lego's images have twice the side, and its held-out images five times.
const LEGO_STRIDE: u32 = 5;
/// Colour of surface without texture.
const PLAIN: DVec3 = DVec3::splat(0.6);

/// What there is to photograph.
#[derive(Clone, Copy)]
pub struct Scene {
    pub name: &'static str,
    up: Up,
    /// Whether the half x < 0 has one colour, without texture and light.
    half_plain: bool,
}

pub const SCENES: [Scene; 6] = [
    Scene { name: "lego", up: Up::Z, half_plain: false },
    Scene { name: "stanford-bunny", up: Up::Y, half_plain: false },
    Scene { name: "spot", up: Up::Y, half_plain: false },
    Scene { name: "armadillo", up: Up::Y, half_plain: false },
    Scene { name: "knot, half plain", up: Up::Z, half_plain: true },
    Scene { name: "deep cup", up: Up::Z, half_plain: false },
];

/// A held-out image.
pub struct Held {
    pub camera: Camera,
    /// `[height · width]`, over white.
    pub colors: Vec<DVec3>,
    /// `[height · width]`, scene units.
    pub distance: Vec<Option<f64>>,
}

/// The images of a scene.
pub struct Images {
    /// Those that may be taken.
    pub shots: Vec<Shot>,
    pub held_out: Vec<Held>,
    pub bounds: Aabb,
    /// If the truth about visibility is known.
    pub mesh: Option<MeshScene>,
}

impl Scene {
    pub fn images(&self) -> Result<Images> {
        if self.name == "lego" {
            return lego();
        }
        let mesh = match self.name {
            "knot, half plain" => read(&knot())?,
            "deep cup" => cup(),
            name => Mesh::read(&Program::data()?.join(format!("meshes/{name}.obj")))?,
        };
        let lit = LitScene::new(MeshScene::new(mesh.placed(self.up).0), &Silent)?;
        // The same spirals as those of `octobayes synth`, turned differently.
        let take = |camera: &Camera| self.photograph(&lit, camera);
        let shot = |(i, camera): (usize, &Camera)| Shot {
            name: i.to_string(),
            camera: *camera,
            image: take(camera).0,
            mask: None,
        };
        let cameras = viewpoints(VIEWS, None, [SIDE; 2], 0);
        let shots = cameras.iter().enumerate().map(shot).collect();
        let held = |camera: &Camera| {
            let (image, distance) = take(camera);
            let colors = (0..image.len()).map(|i| image.over(i, DVec3::ONE)).collect();
            Held { camera: *camera, colors, distance }
        };
        let held_out = viewpoints(TEST_VIEWS, None, [TEST_SIDE; 2], 0x7e57).iter().map(held).collect();
        let mesh = MeshScene::new(mesh.placed(self.up).0);
        Ok(Images { shots, held_out, bounds: MeshScene::bounds(), mesh: Some(mesh) })
    }

    /// A picture from 2 × 2 samples a pixel, and the distance along the ray through each pixel's centre.
    fn photograph(&self, lit: &LitScene, camera: &Camera) -> (PosedImage, Vec<Option<f64>>) {
        let [width, height] = camera.resolution;
        let pixel = |i: u32| {
            let [column, row] = [i % width, i / width].map(f64::from);
            let (mut sum, mut hits) = (DVec3::ZERO, 0_u32);
            for [x, y] in [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]] {
                let ray = camera.ray(column + x, row + y);
                if let Some(hit) = lit.scene().nearest(&ray) {
                    let is_plain = self.half_plain && ray.at(hit.t).x < 0.0;
                    sum += if is_plain { PLAIN } else { lit.color(&ray, &hit) };
                    hits += 1;
                }
            }
            let byte = |v: f64| (255.0 * v).round() as u8;
            let [red, green, blue] = (sum / f64::from(hits.max(1))).to_array().map(byte);
            let center = lit.scene().nearest(&camera.ray(column + 0.5, row + 0.5));
            ([red, green, blue, byte(0.25 * f64::from(hits))], center.map(|hit| hit.t))
        };
        let (rgba, distance) = (0..width * height).into_par_iter().map(pixel).unzip();
        (PosedImage::new(camera.resolution, rgba), distance)
    }
}

/// A mesh from the text of its file.
fn read(text: &str) -> Result<Mesh> {
    let file = tempfile::NamedTempFile::new().map_err(Error::io(Path::new("a temporary file"), "cannot create"))?;
    std::fs::write(file.path(), text).map_err(Error::io(file.path(), "cannot write"))?;
    Mesh::read(file.path())
}

/// Lego: every third image of the training cameras, and some test images, whose depth maps have steps of 0.03.
fn lego() -> Result<Images> {
    let folder = Program::data()?.join("nerf-lego-400");
    let [shots, _] = DatasetFiles::read(&folder)?.load(&Silent)?;
    let every = shots.len().div_ceil(VIEWS as usize).max(1);
    let shots = shots.into_iter().step_by(every).map(|shot| shot.shrunk([SIDE; 2])).collect::<Result<_>>()?;
    let bounds = DatasetFiles::read(&folder)?.bounds;
    let views = Views::read(&folder.join("transforms_test.json"), None)?;
    let (maps, pattern) = (Some(folder.join("test")), DepthFiles::PATTERN.into());
    let files = DepthFiles { folder: maps, pattern, scale: Some([8.0, -8.0]), kind: DepthKind::Euclidean };
    let found = files.find(&views.path, &views.frames, &views.frames)?;
    let depth = DepthMeaning { encoding: found.encoding, bounds, jump: 0.0 };
    let every = found.frames.len().div_ceil(TEST_VIEWS as usize).max(1);
    let held = found.frames.iter().step_by(every).map(|frame| {
        let view = TrueView::read(frame, Some(&depth), DVec3::ONE, 0.5, LEGO_STRIDE)?;
        Ok(Held { camera: view.camera, colors: view.colors, distance: view.distance })
    });
    Ok(Images { shots, held_out: held.collect::<Result<_>>()?, bounds, mesh: None })
}
