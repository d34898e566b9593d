//! What U is a deviation of.

use clap::Args;

use super::heading;
use super::parse::{choice, parse_noise};
use octobayes_session::ScaleKind;

/// The scale of U, and what that of the training pixels needs.
#[derive(Args)]
pub struct ScaleOptions {
    /// The evidence behind U: one noisy training ray, as in the paper (U only ranks places), or all training pixels (U
    /// is a standard deviation in scene units) [default: paper, or what --for sets]
    #[arg(long, value_parser = choice::<ScaleKind>(), help_heading = heading::STATISTICS)]
    pub scale: Option<ScaleKind>,

    /// For --scale data: RMSE of the model's colours (0..1) on its training images, 10^(-PSNR/20): 0.032 at 30 dB
    /// [default: what a model of `train` or `demo` stores, or by some pixels of the images beside the cameras]
    #[arg(
        long,
        value_name = "RMSE",
        value_parser = parse_noise,
        allow_negative_numbers = true,
        help_heading = heading::STATISTICS,
    )]
    pub noise: Option<f64>,
}
