//! Options shared by several verbs.

mod cameras;
pub mod depth;
mod grid;
mod numbers;
mod parse;
mod scale;
mod threshold;

pub use cameras::{CameraFile, CameraOptions, FrameOptions, warn_of_pixels};
pub use depth::DepthOptions;
pub use grid::{DomainOptions, GridOptions, OfficialOptions, check_field_name};
pub use numbers::{MOST, MOST_KEPT, count, parse_interval, parse_time};
pub use parse::{
    Resolution, UTF_8, model_name, numbers, parse_background, parse_box, parse_bytes, parse_frames, parse_non_negative,
    parse_pair, parse_positive, parse_probability, parse_range, parse_resolution, parse_share, parse_views, scaled,
};
pub use scale::TrainingPixels;
pub use threshold::Threshold;

use clap::{Args, ValueEnum};
use glam::Vec3;

use crate::Result;
use crate::estimate::RaySettings;
use crate::field::{Coordinates, RadianceField};
use crate::render::{Occupancy, RayAverage};

impl ValueEnum for Coordinates {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::Ngp => "the file's own: the object in [0, 1]^3",
            Self::Blender => "those of the NeRF-synthetic transforms.json files: 0.33 x + 0.5 with cycled axes",
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
}

impl ValueEnum for RayAverage {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::WeightedMean => "mean of log10 U over what the ray hits",
            Self::Official => "the official code's: -3 for the part that hits nothing",
            Self::AtExpected => "log10 U at the expected depth",
            Self::USpread => {
                "log10 (U s) at the expected depth, where s is the spread of the ray's weights: s^2 is their variance \
                 + delta^2/12 for the length delta of a sample"
            }
            Self::USpreadPerRootRay => {
                "log10 (U s / sqrt(n)), where n is the number of training rays around the expected depth: for ranking \
                 pixels"
            }
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
}

/// A radiance field, and how rays pass through it.
#[derive(Args)]
pub struct ModelOptions {
    /// The trained model: a `.safetensors` hash grid (of `octobayes train`) or MLP NeRF, a `.ppng` Plenoptic PNG,
    /// an `.npz` voxel grid (density, color, box), or `scene:NAME` for a built-in scene
    #[arg(value_name = "MODEL", value_parser = model_name())]
    pub model: String,

    #[command(flatten)]
    pub rays: RayOptions,
}

/// How rays pass through a radiance field.
#[derive(Args, Clone, Copy)]
pub struct RayOptions {
    /// Scene units and axes of a `.ppng` model; fields, cameras and depth must use the same [default: ngp]
    #[arg(long, value_enum)]
    pub coordinates: Option<Coordinates>,

    /// Colour behind the scene: white, black or r,g,b in [0, 1]. It enters the derivatives through the final
    /// transmittance of rays, so use what the model was trained with
    #[arg(long, value_name = "COLOR", default_value = "white", value_parser = parse_background)]
    pub background: Vec3,

    /// Distance between samples along a ray, scene units [default: what the model suggests]
    #[arg(long, value_name = "LENGTH", value_parser = parse_positive)]
    pub march_step: Option<f64>,

    /// Where rays pass through a pixel: 0.5 for its centre, 0 for its upper left corner [default: as the model
    /// was trained]
    #[arg(long, value_name = "OFFSET", value_parser = parse_share)]
    pub pixel_offset: Option<f64>,

    /// Cells per axis of the occupancy grid that lets rays skip empty space
    #[arg(
        long,
        value_name = "N",
        default_value_t = Occupancy::DEFAULT_RESOLUTION as u16,
        value_parser = clap::value_parser!(u16).range(4..=512),
    )]
    pub occupancy: u16,
}

impl ModelOptions {
    /// Opens the model.
    pub fn open(&self) -> Result<Box<dyn RadianceField>> {
        crate::open::open_in(&self.model, self.rays.coordinates)
    }

    /// Settings for rendering images.
    pub fn image_settings(&self) -> RaySettings {
        self.rays.ray_settings(RaySettings::for_images())
    }
}

impl RayOptions {
    /// `others`, with these options filled in.
    pub fn ray_settings(&self, others: RaySettings) -> RaySettings {
        RaySettings {
            march_step: self.march_step,
            background: self.background,
            pixel_offset: self.pixel_offset,
            occupancy: usize::from(self.occupancy),
            ..others
        }
    }
}
