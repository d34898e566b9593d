//! What a run reads, and what it is of it.

use std::path::{Path, PathBuf};

use super::{Args, Rays};
use crate::cli::options::{TrainingPixels, warn_of_pixels};
use crate::cli::progress::Bars;
use crate::dataset::{Views, check_masks, kept_pixels, read_masks};
use crate::estimate::{Estimation, GridSettings, RaySettings};
use crate::field::RadianceField;
use crate::geometry::{Camera, Domain, Mask};
use crate::posterior::Scale;
use crate::{Error, Result};

/// The model, its training cameras, and what identifies them.
pub struct Inputs {
    /// The model.
    pub field: Box<dyn RadianceField>,
    /// The training frames.
    pub views: Views,
    cameras: Vec<Camera>,
    /// Which pixels of each camera the model was trained on, if not all.
    masks: Vec<Option<Mask>>,
    domain: Domain,
    /// Checksum of the model's content.
    checksum: u32,
    /// Names and checksums of the model and the camera file, if there is one.
    pub files: Vec<String>,
}

impl Inputs {
    /// The part of space that the field covers.
    pub fn domain(&self) -> Domain {
        self.domain
    }
}

/// Reads the masks of the frames. Says on stderr what they leave out.
fn masks(views: &Views) -> Result<Vec<Option<Mask>>> {
    let masks = read_masks(&views.frames)?;
    check_masks(&views.path, &masks)?;
    let masked = masks.iter().flatten().count();
    if masked > 0 {
        let cameras = views.cameras();
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let left_out = 100.0 * (1.0 - kept_pixels(&cameras, &masks) as f64 / all as f64);
        announce!("note: masks of {masked} of {} frames leave out {left_out:.1} % of the pixels", cameras.len());
    }
    Ok(masks)
}

/// A file's name and checksum. A built-in scene has only a name.
fn identity(file: &Path) -> Result<String> {
    let name = file.to_string_lossy();
    if name.starts_with("scene:") {
        return Ok(name.into());
    }
    Ok(format!("{name} ({:08x})", crc32fast::hash(&crate::io::read(file)?)))
}

impl Args {
    /// Reads model and cameras.
    pub fn read(&self) -> Result<Inputs> {
        let files = self.files();
        let field = self.model.open()?;
        let views = self.cameras.training(&self.frames, &*field, &self.model.model)?;
        // Checked only now: if a file is at fault, the model's and cameras' readers explain it better.
        let files = files?;
        // The result names these files by their checksums, so they must not have changed meanwhile.
        let now = self.files()?;
        if let Some((before, now)) = files.iter().zip(&now).find(|(before, now)| before != now) {
            return Err(Error::setting("an input file", format!("{before}, as before it was read"), now));
        }
        let domain = self.domain.domain(Some(field.natural_domain()))?;
        let checksum = crate::open::checksum(&self.model.model, self.model.rays.coordinates)?;
        let (cameras, masks) = (views.cameras(), masks(&views)?);
        Ok(Inputs { field, views, cameras, masks, domain, checksum, files })
    }

    /// The run over what was read, without checkpoint.
    pub fn estimation<'a>(&self, inputs: &'a Inputs, bars: &'a Bars) -> Result<(Estimation<'a>, GridSettings)> {
        let Inputs { field, views, cameras, masks, domain, checksum, files } = inputs;
        let rays = self.model.rays.ray_settings(RaySettings {
            rays: self.most_rays(),
            pixels: self.pixels,
            seed: self.seed,
            gradient: self.gradient,
            step: self.step,
            cutoff: self.cutoff,
            ..RaySettings::default()
        });
        let pixels = kept_pixels(cameras, masks);
        let training = TrainingPixels { pixels: Some(pixels), noise: field.training_noise() };
        let grid = self.grid.settings(domain, training)?;
        if matches!(grid.scale, Scale::Data(_)) {
            warn_of_pixels(views, pixels);
        }
        let estimation = Estimation::new(&**field, cameras).masks(masks).domain(*domain).rays(rays).grid(grid);
        let estimation = estimation.source(self.source(files, cameras)).model(*checksum).monitor(bars);
        let estimation = estimation.coarser_levels(self.coarser_levels.unwrap_or(0));
        Ok((self.goal(estimation, grid.tolerance)?, grid))
    }

    /// Sets which rays are drawn, and when the run ends.
    fn goal<'a>(&self, estimation: Estimation<'a>, tolerance: f64) -> Result<Estimation<'a>> {
        let others = [
            ("--shard", self.shard.is_some()),
            ("--error-bars", self.error_bars.is_some()),
            ("--dump-samples", self.dump_samples.is_some()),
        ];
        Ok(match (self.rays, self.shard, self.error_bars) {
            (Rays::Auto, ..) => {
                if let Some((name, _)) = others.into_iter().find(|(_, given)| *given) {
                    return Err(Error::setting("--rays auto", "a run by itself, to its end", name));
                }
                estimation.until_mean_error(tolerance)
            }
            (_, Some([index, of]), _) => estimation.shard(index, of),
            (.., Some(groups)) => estimation.error_bars(groups),
            _ => estimation,
        })
    }

    /// Rays of the run, or the most that it may draw.
    fn most_rays(&self) -> u64 {
        match self.rays {
            Rays::Count(rays) => rays,
            Rays::Auto => self.max_rays,
        }
    }

    /// The model and the camera file, if there is one, with their checksums.
    fn files(&self) -> Result<Vec<String>> {
        let cameras = self.cameras.cameras.iter().flat_map(|path| Views::files(path));
        [PathBuf::from(&self.model.model)].into_iter().chain(cameras).map(|file| identity(&file)).collect()
    }

    /// What the field was computed from, which identifies the run.
    fn source(&self, files: &[String], cameras: &[Camera]) -> String {
        let mut model = files[0].clone();
        if let Some(coordinates) = self.model.rays.coordinates {
            model = format!("{model} in {} coordinates", coordinates.name());
        }
        let seen_by = match &files[1..] {
            [] => {
                let [w, h] = cameras[0].resolution;
                let fov = self.cameras.fov.map_or(String::new(), |fov| format!(", {fov} degrees"));
                format!("its own {} cameras of {w} x {h}{fov}", cameras.len())
            }
            files => files.join(" and "),
        };
        format!("{model} seen by {seen_by}")
    }
}
