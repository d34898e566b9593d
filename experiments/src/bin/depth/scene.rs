//! A mesh or lego, what a model saw of it, and the model.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use octobayes::geometry::{Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, DepthReadings, Frame, Views};
use octobayes_depth::Photograph;
use octobayes_evaluation::{DepthFiles, DepthMeaning, TrueParts, TrueView};
use octobayes_models::HashGrid;
use octobayes_synth::{DEPTH_PNG_SCALE, DatasetSettings, Mesh, MeshScene, Up, write_dataset};
use octobayes_train::{DatasetFiles, Selection, Shot, TrainSettings, quality};
use serde::Serialize;

use common::kitchen::kitchen;
use common::knot::knot;
use common::program::Program;
use common::train::hash_grid;
use common::visibility::{NEAR, is_seen};

/// Side of the images of meshes, pixels.
pub const SIDE: u32 = 200;
/// Of lego's images, which have 400 pixels a side, every so many pixels count where all of a mesh's would.
const LEGO_STRIDE: u32 = 2;
/// Views around a mesh, of which a scene takes some.
const VIEWS: u32 = 40;
/// Held-out views all around.
pub const TEST_VIEWS: u32 = 20;
/// Pixels of training images by which their noise is measured, about.
const PIXELS: usize = 20_000;
/// Every so many pixels of the training images count for the quality of a model that others trained, along x and y.
const QUALITY_STRIDE: u32 = 4;
/// Distance between the values of lego's depth maps, scene units.
const LEGO_STEP: f64 = 8.0 / 255.0;
/// Neighbouring depths that differ by more steps of the map than this straddle an edge.
const EDGE: f64 = 2.5;

/// Which views of a mesh a model is trained on.
#[derive(Clone, Copy, PartialEq, Serialize)]
pub enum Seen {
    /// So many, all around.
    Few(usize),
    /// Those from azimuths between these two, degrees.
    Arc(f64, f64),
}

/// A mesh or lego, which way up it stands, what was seen of it, and how long models of it are trained.
#[derive(Clone, Copy)]
pub struct Scene {
    pub mesh: &'static str,
    pub up: Up,
    pub seen: Seen,
    /// Steps of training.
    pub steps: u64,
}

impl Scene {
    pub fn name(&self) -> String {
        let seen = match self.seen {
            Seen::Few(views) => format!("{views} views"),
            Seen::Arc(from, to) if to - from > 180.0 => format!("hole of {:.0}°", 360.0 - (to - from)),
            Seen::Arc(from, to) => format!("arc of {:.0}°", to - from),
        };
        format!("{}, {seen}", self.mesh)
    }

    /// The mesh's file, and the images of it in a folder.
    fn images(&self, folder: &Path) -> Result<PathBuf> {
        let file = if self.mesh == "knot" {
            let file = folder.with_extension("obj");
            std::fs::write(&file, knot()).map_err(Error::io(&file, "cannot write"))?;
            file
        } else {
            Program::data()?.join(format!("meshes/{}.obj", self.mesh))
        };
        let settings = DatasetSettings::default().up(self.up).views(VIEWS).test_views(TEST_VIEWS);
        write_dataset(&file, folder, &settings.resolution([SIDE; 2]).samples_per_side(2), &Silent)?;
        Ok(file)
    }

    fn selection(&self, folder: &Path) -> Result<Selection> {
        let (from, to) = match self.seen {
            Seen::Few(views) => return Ok(Selection::Count(views)),
            Seen::Arc(from, to) => (from, to),
        };
        let frames = Views::read(&folder.join("transforms_train.json"), None)?.frames;
        let azimuth = |camera: &Camera| camera.position.y.atan2(camera.position.x).to_degrees().rem_euclid(360.0);
        let inside = |camera: &Camera| (azimuth(camera) - from).rem_euclid(360.0) < to - from;
        Ok(Selection::Indices((0..frames.len()).filter(|&i| inside(&frames[i].camera)).collect()))
    }

    /// Reads lego's images, or makes those of a mesh, below `folder`.
    pub fn data(&self, folder: &Path) -> Result<Data> {
        if self.mesh == "lego" {
            return Data::lego(&self.selection(&lego()?)?, LEGO_STRIDE);
        }
        let folder = folder.join("images");
        if self.mesh == "kitchen" {
            let depth = kitchen(&folder)?;
            return Data::read(folder.clone(), &self.selection(&folder)?, depth, 1);
        }
        let file = self.images(&folder)?;
        let mesh = MeshScene::new(Mesh::read(&file)?.placed(self.up).0);
        let (maps, pattern) = (Some(folder.join("depth")), "{}.png".into());
        let depth =
            DepthFiles { folder: maps, pattern, scale: Some([0.0, DEPTH_PNG_SCALE]), kind: DepthKind::Euclidean };
        let data = Data::read(folder.clone(), &self.selection(&folder)?, depth, 1)?;
        Ok(Data { mesh: Some(mesh), ..data })
    }

    /// Trains a model of the scene.
    pub fn train(&self, data: &Data, seed: u64) -> Result<Model> {
        let field = hash_grid(TrainSettings::default().seed(seed), data.domain, &data.shots, self.steps)?;
        let psnr = quality(&field, &data.shots, Vec3::ONE, PIXELS).map_or(f64::NAN, |quality| quality.psnr);
        Ok(Model { field, psnr })
    }
}

/// What there is to train on, and the truth about the scene.
pub struct Data {
    pub domain: Domain,
    shots: Vec<Shot>,
    /// Of the training images.
    pub cameras: Vec<Camera>,
    /// If the truth about visibility is known.
    mesh: Option<MeshScene>,
    /// The data set.
    pub folder: PathBuf,
    /// True depth of the held-out views.
    depth: DepthFiles,
    /// Pixels whose neighbours' depth differs by more than this have none, scene units: the maps are means over them.
    edge: Option<f64>,
    /// Every so many pixels count where all pixels of a mesh's images would, along x and y.
    stride: u32,
}

/// A trained model.
pub struct Model {
    pub field: HashGrid,
    /// Of the training images, dB.
    pub psnr: f64,
}

impl Data {
    /// True depth of the held-out views.
    pub fn depth_files(&self) -> DepthFiles {
        self.depth.clone()
    }

    /// A selection of a data set's training images.
    fn read(folder: PathBuf, selection: &Selection, depth: DepthFiles, stride: u32) -> Result<Self> {
        let mut files = DatasetFiles::read(&folder)?;
        files.select(selection, None)?;
        let [shots, _] = files.load(&Silent)?;
        let cameras = shots.iter().map(|shot| shot.camera).collect();
        let domain = Domain::Box(files.bounds);
        Ok(Self { domain, shots, cameras, mesh: None, folder, depth, edge: None, stride })
    }

    /// Lego. Its depth maps have eight bits over eight scene units, and are means over four pixels of larger ones.
    pub fn lego(selection: &Selection, stride: u32) -> Result<Self> {
        let folder = lego()?;
        let (maps, pattern) = (Some(folder.join("test")), "{}_depth_0001.png".into());
        let depth = DepthFiles { folder: maps, pattern, scale: Some([8.0, -8.0]), kind: DepthKind::Euclidean };
        let data = Self::read(folder, selection, depth, stride)?;
        Ok(Self { edge: Some(EDGE * LEGO_STEP), ..data })
    }

    /// Every so many pixels of the held-out views, along x and y.
    pub fn held_out(&self, pixel_offset: f64, stride: u32) -> Result<Vec<TrueView>> {
        self.held_out_with(pixel_offset, stride, 0.0)
    }

    /// The same with the kinds of their pixels. A depth jumps if it changes by more than `jump`, scene units.
    pub fn held_out_with(&self, pixel_offset: f64, stride: u32, jump: f64) -> Result<Vec<TrueView>> {
        let views = Views::read(&self.folder.join("transforms_test.json"), None)?;
        self.true_views(&views, &views.frames, pixel_offset, stride, jump)
    }

    /// The training views of a mesh; none where their depth is not known.
    pub fn own_views(&self, pixel_offset: f64, jump: f64) -> Result<Vec<TrueView>> {
        if self.mesh.is_none() {
            return Ok(Vec::new());
        }
        let views = Views::read(&self.folder.join("transforms_train.json"), None)?;
        let names: Vec<&str> = self.shots.iter().map(|shot| &*shot.name).collect();
        let own: Vec<Frame> = views.frames.iter().filter(|frame| names.contains(&&*frame.name)).cloned().collect();
        self.true_views(&views, &own, pixel_offset, 1, jump)
    }

    fn true_views(
        &self,
        views: &Views,
        frames: &[Frame],
        pixel_offset: f64,
        stride: u32,
        jump: f64,
    ) -> Result<Vec<TrueView>> {
        let found = self.depth.find(&views.path, frames, &views.frames)?;
        let (frames, encoding) = (found.frames, found.encoding);
        let all_of_space = || Error::setting("domain", "a box", "all of space");
        let bounds = *self.domain.bounds().ok_or_else(all_of_space)?;
        let depth = DepthMeaning { encoding, bounds, jump };
        let every = frames.len().div_ceil(TEST_VIEWS as usize).max(1);
        let stride = stride * self.stride;
        let read = |frame: &Frame| {
            let read = |stride| TrueView::read(frame, Some(&depth), DVec3::ONE, pixel_offset, stride);
            let mut view = read(stride)?;
            if let Some(edge) = self.edge {
                let whole = read(1)?;
                let [width, _] = view.camera.resolution;
                for (i, distance) in (0..).zip(&mut view.distance) {
                    *distance =
                        distance.filter(|_| !is_beside_edge(&whole, [i % width, i / width].map(|n| n * stride), edge));
                }
            }
            Ok(view)
        };
        frames.iter().step_by(every).map(read).collect()
    }

    /// The training cameras, as everything but training and rays looks through them.
    pub fn strided_cameras(&self, pixel_offset: f64) -> Vec<Camera> {
        self.cameras.iter().map(|camera| camera.strided(self.stride, pixel_offset)).collect()
    }

    pub fn shots(&self) -> &[Shot] {
        &self.shots
    }

    /// The training images.
    pub fn photographs(&self, pixel_offset: f64) -> Vec<Photograph> {
        let photograph =
            |shot: &Shot| Photograph::new(shot.camera, shot.image.clone(), shot.mask.clone(), DVec3::ONE, pixel_offset);
        self.shots.iter().map(photograph).collect()
    }

    /// The training images, without depth.
    pub fn images(&self, pixel_offset: f64) -> Vec<TrueView> {
        self.shots.iter().map(|shot| image(shot, pixel_offset, QUALITY_STRIDE * self.stride)).collect()
    }

    /// Whether it is known that no training camera saw this point of the true surface.
    pub fn is_unseen(&self, x: DVec3) -> bool {
        self.mesh.as_ref().is_some_and(|mesh| !self.cameras.iter().any(|camera| is_seen(mesh, camera, x, NEAR)))
    }
}

/// Whether a pixel of a view has neighbours of unknown depth, or of depths farther apart than `edge`.
fn is_beside_edge(view: &TrueView, [x, y]: [u32; 2], edge: f64) -> bool {
    let [width, height] = view.camera.resolution;
    let around = |n: u32, most: u32| n.saturating_sub(1)..=(n + 1).min(most - 1);
    let pixels = around(y, height).flat_map(|row| around(x, width).map(move |column| row * width + column));
    let depths: Option<Vec<f64>> = pixels.map(|i| view.distance[i as usize]).collect();
    let Some(depths) = depths else { return true };
    let [low, high] = [f64::min, f64::max].map(|either| depths.iter().copied().reduce(either).unwrap_or(0.0));
    high - low > edge
}

/// The folder of lego's images.
fn lego() -> Result<PathBuf> {
    Ok(Program::data()?.join("nerf-lego-400"))
}

/// Every so many pixels of a training image, along x and y.
fn image(shot: &Shot, pixel_offset: f64, stride: u32) -> TrueView {
    let camera = shot.camera.strided(stride, pixel_offset);
    let [width, height] = camera.resolution;
    let full = |row: u32, column: u32| ((row * shot.camera.resolution[0] + column) * stride) as usize;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| full(row, column)));
    let colors: Vec<DVec3> = pixels.map(|i| shot.image.over(i, DVec3::ONE)).collect();
    let (kept, covered, distance) = (vec![true; colors.len()], vec![true; colors.len()], vec![None; colors.len()]);
    let readings = DepthReadings::default();
    TrueView {
        name: shot.name.clone(),
        camera,
        whole: shot.camera,
        stride,
        pixel_offset,
        colors,
        kept,
        covered,
        distance,
        readings,
        parts: TrueParts::default(),
    }
}
