//! `train --splats`: from images to a file of Gaussian splats, with the cameras beside it.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::checks::{check_framing, note_box, warn_of_one_color};
use super::member::state_file;
use super::{Args, LOOK_PIXELS};
use crate::files::CommandFiles;
use crate::given::Given;
use crate::progress::Bars;
use octobayes::geometry::{Camera, Domain};
use octobayes::io::AtomicFile;
use octobayes::io::place::folder_of;
use octobayes::{Error, Result};
use octobayes_data::{image_path, inria_text, transforms_text};
use octobayes_train::{
    Budget, DatasetFiles, Finished, Quality, Run, Shot, SplatOrigin, SplatSettings, SplatTrainer, StateFile, Training,
    box_of_points,
};

/// Pixels of images that are compared during training. An image of splats is drawn in a few milliseconds.
const LOOK: usize = 20 * LOOK_PIXELS;
/// Pixels of images that are compared at the end.
const TEST: usize = 500 * LOOK_PIXELS;

/// What the comment begins with by which a model names the files beside it.
const BESIDE: &str = "checksums of cameras.json and transforms.json: ";

/// What is written beside a model: the cameras as the original code has them, and with all of their lens.
struct Beside([(PathBuf, String); 2]);

impl Beside {
    /// The paths of both files.
    fn paths(model: &Path) -> [PathBuf; 2] {
        ["cameras.json", "transforms.json"].map(|name| folder_of(model).join(name))
    }

    fn new(model: &Path, shots: &[Shot]) -> Self {
        let cameras: Vec<(String, Camera)> = shots.iter().map(|shot| (name_of(shot), shot.camera)).collect();
        let [first, second] = Self::paths(model);
        Self([(first, inria_text(&cameras)), (second, transforms_text(&cameras))])
    }

    /// The comment by which the model names both files, to be found again by [`Beside::check`].
    fn comment(&self) -> String {
        let [first, second] = self.0.each_ref().map(|(_, text)| crc32fast::hash(text.as_bytes()));
        format!("{BESIDE}{first:08x} {second:08x}")
    }

    /// Refuses to replace files other than those that the model at this path names.
    fn check(model: &Path) -> Result<()> {
        let named = named_beside(model);
        for (k, path) in Self::paths(model).into_iter().enumerate() {
            let Ok(found) = std::fs::read(&path) else { continue };
            if named.map(|sums| sums[k]) != Some(crc32fast::hash(&found)) {
                let expected = "a folder without other cameras, as cameras.json and transforms.json are written there";
                return Err(Error::setting("--output", expected, path.display().to_string()));
            }
        }
        Ok(())
    }

    /// Refuses a folder in which the cameras would find images: those of a camera file with images and without a list
    /// are split, and some of the training views would count as held out.
    fn check_names(model: &Path, shots: &[Shot]) -> Result<()> {
        let folder = folder_of(model);
        let folders = [folder, &folder.join("images")];
        let below = |shot: &Shot| folders.map(|folder| image_path(folder, &name_of(shot)));
        match shots.iter().flat_map(below).find(|path| path.exists()) {
            None => Ok(()),
            Some(path) => {
                let expected = "a folder without the training images, beside which the cameras would be split again";
                Err(Error::setting("--output", expected, path.display().to_string()))
            }
        }
    }

    fn write(&self) -> Result<()> {
        self.0.iter().try_for_each(|(path, text)| AtomicFile::write(path, text.as_bytes()))
    }
}

/// The name of a picture in the files that are written: of an absolute path, the end.
fn name_of(shot: &Shot) -> String {
    let path = Path::new(&shot.name);
    let end = path.file_name().filter(|_| path.is_absolute());
    end.map_or_else(|| shot.name.clone(), |end| end.to_string_lossy().into_owned())
}

/// The checksums of the files beside a model, as a model that was trained here names them.
fn named_beside(model: &Path) -> Option<[u32; 2]> {
    let mut start = Vec::new();
    File::open(model).ok()?.take(4096).read_to_end(&mut start).ok()?;
    let start = String::from_utf8_lossy(&start);
    let mut sums = start.lines().find_map(|line| line.split_once(BESIDE))?.1.split(' ');
    let mut next = || u32::from_str_radix(sums.next()?, 16).ok();
    Some([next()?, next()?])
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
        let command_files = |dataset: &Path| {
            let files = CommandFiles::default().output("--output", model);
            let files = files.output("the state of --output", state_file(model));
            files.outputs("the cameras of --output", Beside::paths(model)).input("DATASET", dataset)
        };
        Beside::check(model)?;
        let mut files = DatasetFiles::read(&self.dataset)?;
        let partner = files.path.with_file_name("transforms_test.json");
        command_files(&files.path).input("DATASET", partner).check()?;
        files.select(&self.views.clone().unwrap_or_default(), None)?;
        self.announce_files(&files);
        let mut points = files.points()?;
        points.retain(|point| self.bounds.is_none_or(|bounds| bounds.contains(point.position.as_vec3())));
        let bounds = self.bounds.or_else(|| box_of_points(&points)).unwrap_or(files.bounds);
        note_box(bounds, &files);
        let domain = Domain::Box(bounds);
        let cameras: Vec<Camera> = files.cameras().map(|camera| camera.resized(self.size(camera))).collect();
        SplatTrainer::check_cameras(&cameras)?;
        let smaller = files.cameras().zip(&cameras).find(|(own, camera)| own.resolution != camera.resolution);
        if let Some((own, camera)) = smaller.filter(|_| self.resolution.is_none()) {
            let [[own_w, own_h], [w, h]] = [own, camera].map(|camera| camera.resolution);
            announce!(
                "note: images of {own_w} x {own_h} are trained on at {w} x {h}; the original code makes them as wide \
                 (--resolution)"
            );
        }
        let [train, held_out] = files.load_at(|camera| self.size(camera), bars)?;
        Beside::check_names(model, &train)?;
        if train.iter().any(|shot| shot.mask.is_some()) {
            announce!(
                "note: the cameras beside the model have no masks; pass --cameras {} to `uncertainty`",
                self.dataset.display()
            );
        }
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
        let (splats, beside) = (trainer.splats()?, Beside::new(model, &train));
        let [width, height] = train[0].camera.resolution;
        let comments = [
            format!("{} train --splats, {} steps, seed {}", env!("CARGO_PKG_VERSION"), trainer.steps(), self.seed),
            format!("{} images, the first of {width} x {height} pixels; background {background}", train.len()),
            beside.comment(),
        ];
        splats.write_ply(model, &[], &comments)?;
        beside.write()?;
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

    /// The size at which the images of a camera are trained on.
    fn size(&self, camera: &Camera) -> [u32; 2] {
        self.resolution.map_or_else(|| SplatTrainer::size(camera), |resolution| resolution.apply(camera).resolution)
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
