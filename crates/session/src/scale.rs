//! What U is a deviation of, as users choose it.

use octobayes::geometry::Domain;
use octobayes::posterior::{DataScale, Scale};
use octobayes::{Error, Result};

octobayes::choices! {
    /// What U is a deviation of.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    pub enum ScaleKind {
        #[default]
        Paper = "paper",
        "The paper's: one ray of a pixel with noise 1/2; for ranking, and for comparison with the official code";
        Data = "data", "A standard deviation in scene units: all training pixels with the noise that training left";
    }
}

/// What is known of the training images.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TrainingPixels {
    /// Their number of pixels.
    pub pixels: Option<u64>,
    /// Root mean square error of their colours that training left.
    pub noise: Option<f64>,
}

impl ScaleKind {
    /// The scale over `domain`. `noise` takes the place of the one that is known.
    ///
    /// # Errors
    /// If `noise` stands beside the paper's scale, if the scale of the data lacks pixels or noise, or as
    /// [`DataScale::new`].
    pub fn over(self, domain: &Domain, noise: Option<f64>, training: TrainingPixels) -> Result<Scale> {
        if self == Self::Paper {
            return match noise {
                Some(_) => Err(Error::setting("--noise", "--scale data beside it", "--scale paper")),
                None => Ok(Scale::Paper),
            };
        }
        let missing = |what, found| Error::setting("--scale data", what, found);
        let pixels = training.pixels.ok_or_else(|| {
            missing("the number of training pixels", "neither `training_pixels` nor a model that stores it")
        })?;
        let noise = noise.or(training.noise).ok_or_else(|| {
            let expected = "the error that training left, --noise 10^(-PSNR/20) by the PSNR of the training images \
                            (30 dB: 0.032)";
            missing(expected, "neither --noise, nor a model that stores it, nor images beside the cameras")
        })?;
        DataScale::new(pixels, noise, DataScale::default_prior_deviation(domain)).map(Scale::Data)
    }
}
