//! What U is a deviation of.

use clap::{Args, ValueEnum};

use super::parse::{parse_noise, parse_positive, parse_psnr};
use crate::geometry::Domain;
use crate::posterior::{DataScale, Scale};
use crate::{Error, Result};

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ScaleName {
    /// The paper's: one ray of a pixel with noise 1/2; for ranking, and for comparison with the official code
    Paper,
    /// A standard deviation in scene units: all training pixels with the noise that training left
    Data,
}

/// The scale of U, and what that of the training pixels needs.
#[derive(Args)]
pub struct ScaleOptions {
    /// What U is a deviation of
    #[arg(long, value_enum, default_value = "paper")]
    scale: ScaleName,

    /// For --scale data: root mean square error of the training pixels' colours, which lie in 0..1 [default: what the
    /// model records, if `train` made it]
    #[arg(
        long,
        value_name = "RMSE",
        value_parser = parse_noise,
        allow_negative_numbers = true,
        conflicts_with = "psnr",
    )]
    noise: Option<f64>,

    /// The same as PSNR of the training images, dB
    #[arg(long, value_name = "DB", value_parser = parse_psnr, allow_negative_numbers = true)]
    psnr: Option<f64>,

    /// For --scale data: deviation along each axis before any image was seen, scene units [default: 0.02 of the
    /// longest edge of the box]
    #[arg(long, value_name = "LENGTH", value_parser = parse_positive)]
    prior_deviation: Option<f64>,
}

/// What is known of the training images.
#[derive(Clone, Copy, Default)]
pub struct TrainingPixels {
    /// Their number of pixels.
    pub pixels: Option<u64>,
    /// Root mean square error of their colours that training left.
    pub noise: Option<f64>,
}

impl ScaleOptions {
    /// The scale that the options ask for over `domain`.
    pub fn scale(&self, domain: &Domain, training: TrainingPixels) -> Result<Scale> {
        if self.scale == ScaleName::Paper {
            let given = [("--noise", self.noise), ("--psnr", self.psnr), ("--prior-deviation", self.prior_deviation)];
            return match given.into_iter().find(|(_, value)| value.is_some()) {
                Some((flag, _)) => Err(Error::setting(flag, "--scale data beside it", "--scale paper")),
                None => Ok(Scale::Paper),
            };
        }
        let missing =
            |flags, what| Error::setting("--scale data", what, format!("neither {flags} nor a model that knows"));
        let pixels = training.pixels.ok_or_else(|| missing("--training-pixels", "the number of training pixels"))?;
        let noise = self.noise.or(self.psnr.map(DataScale::noise_of)).or(training.noise);
        let noise = noise.ok_or_else(|| missing("--noise or --psnr", "the noise that training left"))?;
        let prior = self.prior_deviation.unwrap_or_else(|| DataScale::default_prior_deviation(domain));
        DataScale::new(pixels, noise, prior).map(Scale::Data)
    }
}
