//! `--refit`: some steps of training after the removal.

use glam::Vec3;
use octobayes::monitor::Monitor;
use octobayes::{Error, Result};
use octobayes_data::{Frame, Views};
use octobayes_splats::Splats;
use octobayes_train::{Background, Refitted, Shot, SplatSettings, SplatTrainer, check_mode, refit};

/// The images of a training that is to go on.
pub struct Refit {
    frames: Vec<Frame>,
    pub steps: u64,
}

impl Refit {
    /// Finds the images, before anything is computed.
    ///
    /// # Errors
    /// If there is none, or if these splats cannot be trained, or not on these cameras.
    pub fn new(splats: &Splats, views: &Views, steps: u64) -> Result<Self> {
        check_mode(splats)?;
        let frames: Vec<Frame> = views.frames.iter().filter(|frame| frame.image.exists()).cloned().collect();
        if frames.is_empty() {
            let first = &views.frames[0];
            let place = if first.image.as_os_str().is_empty() { "no image" } else { "none" };
            let tried = if place == "none" { format!(" (tried {})", first.image.display()) } else { String::new() };
            let expected = "cameras with their training images: --cameras of the data set, not those beside a model";
            return Err(Error::setting("--refit", expected, format!("{place} of {}{tried}", views.path.display())));
        }
        if frames.len() < views.frames.len() {
            announce!(
                "note: --refit trains on {} of {} views: the others have no image",
                frames.len(),
                views.frames.len()
            );
        }
        let resized = |frame: &Frame| frame.camera.resized(SplatTrainer::size(&frame.camera));
        SplatTrainer::check_cameras(&frames.iter().map(resized).collect::<Vec<_>>())?;
        Ok(Self { frames, steps })
    }

    /// Trains what is left. `None` if the images do not become better: a scene for which the rates are too large.
    pub fn run(&self, left: &Splats, background: Vec3, monitor: &dyn Monitor) -> Result<Option<Refitted>> {
        let shots = Shot::load(&self.frames, SplatTrainer::size, monitor)?;
        let is_cut_out = |shot: &Shot| (0..shot.image.len()).any(|i| !shot.image.is_opaque(i));
        // What is behind cut-out objects may be anything, so that splats do not take its place.
        let background = match shots.iter().any(is_cut_out) {
            true => Background::Random,
            false => Background::Fixed(background.to_array()),
        };
        let settings = SplatSettings::default().background(background);
        let refitted = refit(left, &shots, settings, self.steps, monitor)?;
        let Some([before, after]) = refitted.psnr else { return Ok(Some(refitted)) };
        announce!("{} steps of training: PSNR {before:.2} to {after:.2} dB on training images", self.steps);
        Ok((after >= before).then_some(refitted))
    }
}
