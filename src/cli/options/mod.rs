//! Options shared by several verbs.

mod cameras;
pub mod depth;
mod grid;
mod numbers;
mod parse;
mod scale;

pub use cameras::{CameraFile, CameraOptions, FrameOptions, of_folder};
pub use depth::DepthOptions;
pub use grid::{DomainOptions, GridOptions, OfficialOptions, check_field_name};
pub use numbers::{MAX_COUNT, MAX_KEPT_COUNT, RayCount, count, parse_time};
pub use parse::{
    Frames, UTF_8, model_name, numbers, parse_background, parse_box, parse_bytes, parse_contraction, parse_direction,
    parse_frames, parse_pair, parse_positive, parse_probability, parse_range, parse_resolution, parse_share,
    parse_views,
};

use clap::{Args, ValueEnum};

use crate::render::RayAverage;
use crate::splats::RenderMode;

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

impl ValueEnum for RayAverage {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::WeightedMean => "mean of log10 U over what the ray hits",
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

impl ValueEnum for RenderMode {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::Classic => "as the original code: small splats grow by 0.3 px^2 and keep their opacity",
            Self::Mip => "as gsplat's `antialiased`: what a splat gains in area it loses in opacity",
            Self::MipSplatting => "as Mip-Splatting's code: the same, but splats grow by 0.1 px^2",
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
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

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use serde::de::DeserializeOwned;
    use serde_json::json;

    use super::*;
    use crate::estimate::GridKind;
    use crate::geometry::Norm;
    use crate::posterior::{Covariance, Criterion};
    use crate::render::GradientMethod;
    use crate::session::{Purpose, ScaleKind};

    /// Files and Python read names by serde, the command line by clap.
    #[test]
    fn values_have_one_spelling_for_all() {
        fn check<T: ValueEnum + DeserializeOwned + PartialEq + Debug>(count: usize) {
            assert_eq!(T::value_variants().len(), count);
            for value in T::value_variants() {
                let name = value.to_possible_value().unwrap().get_name().to_string();
                assert_eq!(&serde_json::from_value::<T>(json!(name)).unwrap(), value);
            }
        }
        check::<Covariance>(3);
        check::<Criterion>(3);
        check::<GradientMethod>(4);
        check::<GridKind>(2);
        check::<Norm>(2);
        check::<RayAverage>(3);
        check::<Purpose>(4);
        check::<ScaleKind>(2);
    }
}
