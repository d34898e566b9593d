//! What U is a deviation of.

use clap::Args;

use super::heading;
use super::parse::parse_noise;
use crate::session::ScaleKind;

/// The scale of U, and what that of the training pixels needs.
#[derive(Args)]
pub struct ScaleOptions {
    /// Whether U counts one noisy training ray, as in the paper, or all training pixels: a standard deviation
    #[arg(long, value_enum, default_value_t, help_heading = heading::STATISTICS)]
    pub scale: ScaleKind,

    /// For --scale data: root mean square error of the training pixels' colours, which lie in 0..1: 10^(-PSNR/20) for
    /// a PSNR in dB, 0.032 for 30 dB [default: what the model records, if `train` made it]
    #[arg(
        long,
        value_name = "RMSE",
        value_parser = parse_noise,
        allow_negative_numbers = true,
        help_heading = heading::STATISTICS,
    )]
    pub noise: Option<f64>,
}
