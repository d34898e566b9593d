//! One photograph: its maps, and what is known of it in numbers.

use std::ops::Deref;
use std::path::{Path, PathBuf};

use glam::DVec3;
use octobayes::metrics::quantile;
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, write_exr};
use octobayes_depth::{SurveyedView, Trust};
use octobayes_show::picture::{write_grey8, write_grey16};
use serde::Serialize;

use super::{Look, Unit};

/// A photograph as the model has it.
pub struct DepthView {
    /// The frame's name.
    pub name: String,
    seen: SurveyedView,
}

impl Deref for DepthView {
    type Target = SurveyedView;

    fn deref(&self) -> &SurveyedView {
        &self.seen
    }
}

/// A photograph in numbers; lengths in the unit of the output.
#[derive(Debug, Clone, Serialize)]
pub struct Quality {
    /// The frame's name.
    pub name: String,
    /// Pixels of its maps.
    pub pixels: usize,
    /// Shares of the pixels, in the order of [`Trust`].
    #[serde(serialize_with = "by_name")]
    pub shares: [f64; Trust::ALL.len()],
    /// Median and 95 % quantile of σ over the trusted pixels; `None` if there is none.
    pub sigma: Option<[f64; 2]>,
    /// Median depth of the trusted pixels.
    pub depth: Option<f64>,
}

fn by_name<S: serde::Serializer>(
    shares: &[f64; Trust::ALL.len()],
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_map(Trust::ALL.iter().map(|trust| trust.name()).zip(shares))
}

/// How maps are written.
#[derive(Debug, Clone, Copy)]
pub struct MapSettings {
    /// The unit of lengths.
    pub unit: Unit,
    /// The length of a step of maps of 16 bits.
    pub step: f64,
    /// What depth is.
    pub kind: DepthKind,
    /// Whether an EXR is written, too.
    pub exr: bool,
}

impl DepthView {
    /// Looks through the training camera `i` at every `stride`-th pixel along x and y.
    pub fn new(look: &Look, i: usize, stride: u32) -> Result<Self> {
        Ok(Self { name: look.frames[i].name.clone(), seen: look.surveyor.view(i, stride, look.bars)? })
    }

    /// Where the surface of every trusted pixel is, by its index, scene units.
    pub fn trusted(&self, pixel_offset: f64) -> impl Iterator<Item = (usize, DVec3)> {
        let points = self.rendered.median_points(&self.camera, pixel_offset).map(|(_, x)| x).enumerate();
        points.filter(|(i, _)| self.trust[*i] == Trust::Trusted)
    }

    /// Depth and deviation of pixel `i` in the unit of the output; `None` where nothing is shown.
    fn depth(&self, i: usize, pixel_offset: f64, settings: &MapSettings) -> Option<[f64; 2]> {
        if self.trust[i] == Trust::Transparent {
            return None;
        }
        let width = self.rendered.resolution[0] as usize;
        let [x, y] = [i % width, i / width].map(|n| n as f64 + pixel_offset);
        let scale = settings.unit.factor / settings.kind.stretch(&self.camera, x, y);
        Some([scale * self.rendered.pixels[i].median_depth, scale * self.sigma[i]])
    }

    /// In numbers.
    pub fn quality(&self, pixel_offset: f64, settings: &MapSettings) -> Quality {
        let n = self.trust.len();
        let share = |trust: Trust| self.trust.iter().filter(|found| **found == trust).count() as f64 / n as f64;
        let trusted = (0..n).filter(|&i| self.trust[i] == Trust::Trusted);
        let found: Vec<[f64; 2]> = trusted.filter_map(|i| self.depth(i, pixel_offset, settings)).collect();
        let sorted = |k: usize| {
            let mut values: Vec<f64> = found.iter().map(|pair| pair[k]).collect();
            values.sort_unstable_by(f64::total_cmp);
            values
        };
        let (depths, sigmas) = (sorted(0), sorted(1));
        let of = |values: &[f64], share: f64| (!values.is_empty()).then(|| quantile(values, share));
        Quality {
            name: self.name.clone(),
            pixels: n,
            shares: Trust::ALL.map(share),
            sigma: of(&sigmas, 0.5).zip(of(&sigmas, 0.95)).map(|(half, most)| [half, most]),
            depth: of(&depths, 0.5),
        }
    }

    /// Writes the maps; `stem` is the path without what ends the names.
    ///
    /// # Errors
    /// If a depth has no place in 16 bits, or a file cannot be written.
    pub fn write(&self, stem: &Path, pixel_offset: f64, settings: &MapSettings) -> Result<()> {
        let size = self.rendered.resolution;
        let found: Vec<Option<[f64; 2]>> =
            (0..self.trust.len()).map(|i| self.depth(i, pixel_offset, settings)).collect();
        let most = f64::from(u16::MAX);
        // What cannot be trusted may lie anywhere: its depth is the largest number, or less.
        let trusted = found.iter().zip(&self.trust).filter(|(_, trust)| **trust == Trust::Trusted);
        let farthest = trusted.filter_map(|(pair, _)| *pair).fold(0.0_f64, |most, pair| most.max(pair[0]));
        if farthest / settings.step > most {
            let least = 10_f64.powf((farthest / most).log10().ceil());
            let name = octobayes::error::printable(&self.name);
            let expected = format!("steps of {least} {} or more, for depths of {name}", settings.unit.name());
            let found =
                format!("{}: 16 bits end at {:.4}, depths at {farthest:.4}", settings.step, most * settings.step);
            return Err(Error::setting("--unit", expected, found));
        }
        // No depth is 0. A deviation that has no place, or is not known, is the largest number.
        let map = |k: usize| -> Vec<u16> {
            let steps = |pair: &[f64; 2]| {
                let steps = (pair[k] / settings.step).round();
                if steps.is_nan() { u16::MAX } else { steps.clamp(1.0, most) as u16 }
            };
            found.iter().map(|pair| pair.as_ref().map_or(0, steps)).collect()
        };
        write_grey16(&named(stem, "depth.png"), size, &map(0))?;
        write_grey16(&named(stem, "sigma.png"), size, &map(1))?;
        let trust: Vec<u8> = self.trust.iter().map(|trust| trust.grey()).collect();
        write_grey8(&named(stem, "trust.png"), size, &trust)?;
        if settings.exr {
            let channel = |k: usize| found.iter().map(|pair| pair.map_or(f32::NAN, |pair| pair[k] as f32)).collect();
            let trust = trust.iter().map(|&grey| f32::from(grey)).collect();
            let channels = vec![("depth.Z", channel(0)), ("sigma.Z", channel(1)), ("trust.V", trust)];
            write_exr(&named(stem, "exr"), size, channels)?;
        }
        Ok(())
    }
}

/// The files of a photograph.
pub fn files(stem: &Path, exr: bool) -> Vec<PathBuf> {
    let ends = ["depth.png", "sigma.png", "trust.png"].into_iter().chain(exr.then_some("exr"));
    ends.map(|end| named(stem, end)).collect()
}

fn named(stem: &Path, end: &str) -> PathBuf {
    let mut name = stem.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{end}"));
    stem.with_file_name(name)
}
