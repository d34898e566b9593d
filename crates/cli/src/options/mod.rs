//! Options shared by several verbs.

mod cameras;
pub mod depth;
mod grid;
mod numbers;
mod parse;
mod scale;

pub use cameras::{CameraFile, CameraOptions, FrameOptions, RunOptions, TrainingOptions, of_folder};
pub use depth::DepthOptions;
pub use grid::{DomainOptions, GridOptions, OfficialOptions, check_field_name};
pub use numbers::{MAX_COUNT, MAX_KEPT_COUNT, RayCount, count, parse_time};
pub use parse::{
    Frames, UTF_8, choice, model_name, numbers, parse_background, parse_box, parse_bytes, parse_contraction,
    parse_direction, parse_frames, parse_noise, parse_norm, parse_pair, parse_positive, parse_probability, parse_range,
    parse_resolution, parse_share, parse_views,
};

use clap::Args;

/// Headings of `--help`, in their order.
pub mod heading {
    pub const INPUT: &str = "Input";
    pub const GRID: &str = "Grid";
    pub const RAYS: &str = "Rays";
    pub const TRAINING: &str = "Training";
    pub const STATISTICS: &str = "Statistics";
    pub const OUTPUT: &str = "Output";
    pub const ADVANCED: &str = "Advanced";
    /// Those of all verbs, which come last.
    pub const GLOBAL: &str = "Everywhere";
}

/// A trained model.
#[derive(Args)]
pub struct ModelArgument {
    /// The trained model: a `.safetensors` hash grid (of `octobayes train`) or MLP NeRF, a `.ppng` Plenoptic PNG,
    /// an `.npz` voxel grid (density, color, box), Gaussian splats (`.ply`, `.compressed.ply`, `.spz`, `.splat`), or
    /// `scene:NAME` for a built-in scene
    #[arg(value_name = "MODEL", value_parser = model_name())]
    pub model: String,
}
