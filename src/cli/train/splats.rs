//! `train --splats`: from images to a file of Gaussian splats, with the cameras beside it.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::checks::{check_framing, note_box, warn_of_one_color};
use super::member::state_file;
use super::{Args, LOOK_PIXELS};
use crate::cli::files::CommandFiles;
use crate::cli::given::Given;
use crate::cli::progress::Bars;
use crate::dataset::{image_path, write_inria, write_transforms};
use crate::error::printable;
use crate::geometry::{Camera, Domain};
use crate::io::place::folder_of;
use crate::splats::SplatRenderer;
use crate::train::{
    Budget, DatasetFiles, Finished, Quality, Run, Shot, SplatOrigin, SplatSettings, SplatTrainer, StateFile, Training,
    box_of_points,
};
use crate::{Error, Result};

/// Pixels of images that are compared during training. An image of splats is drawn in a few milliseconds.
const LOOK: usize = 20 * LOOK_PIXELS;
/// Pixels of images that are compared at the end.
const TEST: usize = 500 * LOOK_PIXELS;

/// What the comment of a model that was trained here says.
const MADE_BY: &str = " train --splats";

/// What is written beside a model: the cameras as the original code has them, and with all of their lens.
struct Beside {
    cameras: PathBuf,
    transforms: PathBuf,
}

impl Beside {
    fn new(model: &Path) -> Self {
        let folder = folder_of(model);
        Self { cameras: folder.join("cameras.json"), transforms: folder.join("transforms.json") }
    }

    /// Refuses to replace files that no run for this model has left.
    fn check(&self, model: &Path, state: &Path) -> Result<()> {
        if is_own(model) || state.exists() {
            return Ok(());
        }
        match [&self.cameras, &self.transforms].into_iter().find(|path| path.exists()) {
            None => Ok(()),
            Some(path) => {
                let expected = "a folder without other cameras, as cameras.json and transforms.json are written there";
                Err(Error::setting("--output", expected, path.display().to_string()))
            }
        }
    }

    /// Refuses a folder in which the cameras would find images: those of a camera file with images and without a list
    /// are split, and some of the training views would count as held out.
    fn check_names(&self, shots: &[Shot]) -> Result<()> {
        let folder = folder_of(&self.cameras);
        match shots.iter().map(|shot| image_path(folder, &name_of(shot))).find(|path| path.exists()) {
            None => Ok(()),
            Some(path) => {
                let expected = "a folder without the training images, beside which the cameras would be split again";
                Err(Error::setting("--output", expected, path.display().to_string()))
            }
        }
    }

    fn write(&self, shots: &[Shot]) -> Result<()> {
        let cameras: Vec<(String, Camera)> = shots.iter().map(|shot| (name_of(shot), shot.camera)).collect();
        write_inria(&self.cameras, &cameras)?;
        write_transforms(&self.transforms, &cameras)
    }
}

/// The name of a picture in the files that are written: of an absolute path, the end.
fn name_of(shot: &Shot) -> String {
    let path = Path::new(&shot.name);
    let end = path.file_name().filter(|_| path.is_absolute());
    end.map_or_else(|| shot.name.clone(), |end| end.to_string_lossy().into_owned())
}

/// Whether a `.ply` says that this program trained it.
fn is_own(model: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(model).and_then(|file| file.take(4096).read_to_end(&mut start));
    read.is_ok() && String::from_utf8_lossy(&start).contains(MADE_BY)
}

impl Args {
    /// Trains splats.
    pub(super) fn run_splats(&self, given: &Given, bars: &Bars) -> Result<()> {
        let of_grids = ["--log2-hashmap-size", "--samples-per-step", "--contract", "--members"];
        given.refuse(&of_grids, "a hash grid, which it is an option of", "--splats")?;
        let model = &self.output;
        if model.extension().is_none_or(|extension| extension != "ply") {
            let found = model.display().to_string();
            return Err(Error::setting("--output", "a name that ends in .ply, for --splats", found));
        }
        let beside = Beside::new(model);
        let command_files = |dataset: &Path| {
            let files = CommandFiles::default().output("--output", model);
            let files = files.output("the state of --output", state_file(model));
            let files = files.output("the cameras of --output", &beside.cameras);
            files.output("the cameras of --output", &beside.transforms).input("DATASET", dataset)
        };
        beside.check(model, &state_file(model))?;
        let mut files = DatasetFiles::read(&self.dataset)?;
        let partner = files.path.with_file_name("transforms_test.json");
        command_files(&files.path).input("DATASET", partner).check()?;
        files.select(&self.views.clone().unwrap_or_default(), None)?;
        files.notes.iter().for_each(|note| announce!("note: {}", printable(note)));
        announce!("note: {}", files.describe());
        let mut points = files.points()?;
        points.retain(|point| self.bounds.is_none_or(|bounds| bounds.contains(point.position.as_vec3())));
        let bounds = self.bounds.or_else(|| box_of_points(&points)).unwrap_or(files.bounds);
        note_box(bounds, &files);
        let domain = Domain::Box(bounds);
        let [train, held_out] = files.load(bars)?;
        beside.check_names(&train)?;
        SplatRenderer::check_cameras(held_out.iter().map(|shot| &shot.camera))?;
        if train.iter().any(|shot| shot.mask.is_some()) {
            announce!(
                "note: the cameras beside the model have no masks; pass --cameras {} to `uncertainty`",
                self.dataset.display()
            );
        }
        let [train, held_out] = [self.shrunk(train)?, self.shrunk(held_out)?];
        check_framing(&train, &domain)?;
        let settings =
            SplatSettings::default().seed(self.seed).background(self.background).most(SplatSettings::most_for(&train));
        let mut trainer = SplatTrainer::new(settings, bounds, &points, &train)?;
        match trainer.origin() {
            SplatOrigin::Hull => {}
            SplatOrigin::Points => {
                announce!("note: splats begin at {} of COLMAP's {} points", trainer.len(), points.len());
            }
            SplatOrigin::Box => announce!(
                "note: splats begin anywhere in the box (--box), and not near the surface of the object: some images \
                 are opaque, or no part of the box is inside all outlines, and COLMAP's points are too few or not there"
            ),
        }
        let state = self.state(&files, settings, domain, &train)?;
        let mut before = 0.0;
        if state.path.exists() && !self.restart {
            before = trainer.restore(&state.path, &state.key)?;
            announce!("note: going on after {} steps", trainer.steps());
        }
        let run =
            Run { budget: self.budget(), held_out: &held_out, pixels: LOOK, looks: 10, state: Some(state.clone()) };
        let finished = self.follow(&run, &mut trainer, before, bars)?;
        self.announce(finished.elapsed, bars);
        let background = settings.background.for_images();
        let splats = trainer.splats()?;
        let [width, height] = train[0].camera.resolution;
        let comments = [
            format!("{}{MADE_BY}, {} steps, seed {}", env!("CARGO_PKG_VERSION"), trainer.steps(), self.seed),
            format!("{} images, the first of {width} x {height} pixels; background {background}", train.len()),
        ];
        splats.write_ply(model, &[], &comments)?;
        beside.write(&train)?;
        if finished.interrupted {
            return Err(Error::Stopped { path: model.clone(), steps: trainer.steps() });
        }
        if state.path.exists() {
            std::fs::remove_file(&state.path).map_err(Error::io(&state.path, "cannot remove"))?;
        }
        let within = match run.budget {
            Budget::Time(time) => Some(super::measuring(time)),
            _ => None,
        };
        let shown = trainer.look(&train, LOOK, within);
        let quality = trainer.look(&held_out, TEST, within);
        warn_of_one_color([("training", &train, shown), ("held-out", &held_out, quality.clone())], background);
        self.report_splats(&trainer, finished, train.len(), quality.as_ref())
    }

    /// The images at the size that --resolution asks for.
    fn shrunk(&self, shots: Vec<Shot>) -> Result<Vec<Shot>> {
        let Some(resolution) = self.resolution else { return Ok(shots) };
        let shrunk = |shot: Shot| {
            let size = resolution.apply(&shot.camera).resolution;
            shot.shrunk(size)
        };
        shots.into_iter().map(shrunk).collect()
    }

    fn state(
        &self,
        files: &DatasetFiles,
        settings: SplatSettings,
        domain: Domain,
        train: &[Shot],
    ) -> Result<StateFile> {
        let mut description = self.description(files, train, settings, domain)?;
        description["resolution"] = json!(train[0].camera.resolution);
        let path = state_file(&self.output);
        if self.restart && path.exists() {
            SplatTrainer::check_state(&path)?;
        }
        Ok(StateFile { path, key: description.to_string(), every: StateFile::EVERY })
    }

    fn report_splats(
        &self,
        trainer: &SplatTrainer,
        finished: Finished,
        images: usize,
        quality: Option<&Quality>,
    ) -> Result<()> {
        let (model, steps, elapsed) = (self.output.display(), trainer.steps(), finished.elapsed);
        let background = self.background.for_images();
        if self.json {
            return say!(
                "{}",
                json!({ "models": [{
                    "model": self.output.to_string_lossy(), "images": images, "splats": trainer.len(), "steps": steps,
                    "seconds": elapsed, "seed": self.seed, "held_out": quality, "background": background.to_array(),
                }] })
            );
        }
        say!("{model}: {}", trainer.splats()?.describe())?;
        let speed = steps as f64 / elapsed.max(1e-9);
        say!("  {images} images, {steps} steps, {elapsed:.1} s, {speed:.1} steps/s, seed {}", self.seed)?;
        if let Some(Quality { psnr, views, pixels }) = quality {
            say!("  PSNR {psnr:.2} dB, mean over {views} held-out images, {pixels} pixels, background {background}")?;
        }
        Ok(())
    }
}
