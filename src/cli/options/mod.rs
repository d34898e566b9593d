//! Options that several verbs share.

mod grid;
mod parse;

pub use grid::{DomainOptions, GridOptions, OfficialOptions};
pub use parse::{
    numbers, parse_background, parse_box, parse_non_negative, parse_pair, parse_positive, parse_range, parse_resolution,
};

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::Vec3;

use self::parse::parse_fov;
use crate::dataset::{Frame, ResolutionSource, Views};
use crate::estimate::RaySettings;
use crate::field::{Coordinates, Intrinsics, RadianceField};
use crate::render::{Blend, Occupancy};
use crate::{Error, Result};

/// What images leave out changes a pixel by no more than this in front and behind: less than half a step of 8 bits.
const IMAGE_CUTOFF: f64 = 1e-4;

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

impl ValueEnum for Blend {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::Hit => "mean of log10 U over what the ray hits",
            Self::Official => "the official code's: -3 for the part that hits nothing",
            Self::Mean => "log10 of the mean U over what the ray hits",
            Self::RootMeanSquare => "log10 of the root of the mean U squared",
            Self::AtExpected => "log10 U at the expected depth",
            Self::AtMedian => "log10 U at the median depth",
            Self::Spread => {
                "log10 (U at the expected depth times the deviation of the ray's weights): for ranking pixels"
            }
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
}

/// A radiance field and how rays go through it.
#[derive(Args)]
pub struct ModelOptions {
    /// The trained field: a `.safetensors` hash grid (of `octobayes train`) or MLP NeRF, a `.ppng` Plenoptic PNG, an `.npz` voxel grid (density, color, box), or
    /// `scene:NAME` for a built-in scene
    #[arg(value_name = "MODEL")]
    pub model: String,

    /// Scene units and axes to use a `.ppng` model in; fields, cameras and depth must all have the same [default: ngp]
    #[arg(long, value_enum)]
    pub coordinates: Option<Coordinates>,

    /// What is behind the scene: white, black or r,g,b in [0, 1]. It enters the derivatives through the rays' final
    /// transmittance: use what the field was trained with
    #[arg(long, value_name = "COLOR", default_value = "white", value_parser = parse_background)]
    pub background: Vec3,

    /// Distance between samples along a ray, scene units [default: what the model suggests]
    #[arg(long, value_name = "LENGTH", value_parser = parse_positive)]
    pub march_step: Option<f64>,

    /// Where in a pixel rays go through: 0.5 for its centre, 0 for its upper left corner [default: as the model was trained]
    #[arg(long, value_name = "OFFSET", value_parser = parse_non_negative)]
    pub pixel_offset: Option<f64>,

    /// Cells per axis of the occupancy grid that lets rays skip empty space
    #[arg(long, value_name = "N", default_value_t = Occupancy::DEFAULT_RESOLUTION as u16, value_parser = clap::value_parser!(u16).range(4..=512))]
    pub occupancy: u16,
}

impl ModelOptions {
    /// Opens the model.
    pub fn open(&self) -> Result<Box<dyn RadianceField>> {
        crate::field::open_in(&self.model, self.coordinates)
    }

    /// How images are rendered.
    pub fn image_settings(&self) -> RaySettings {
        self.ray_settings(RaySettings { cutoff: IMAGE_CUTOFF, ..RaySettings::default() })
    }

    /// `others` with what these options say.
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

/// A camera file.
#[derive(Args)]
pub struct CameraFile {
    /// transforms.json with intrinsics and camera-to-world poses (OpenGL axes)
    #[arg(long, value_name = "JSON")]
    pub cameras: PathBuf,

    /// Image size, W or WxH [default: from the camera file, else from its first image, else 400x400]
    #[arg(long, value_name = "SIZE", value_parser = parse_resolution)]
    pub resolution: Option<[u32; 2]>,
}

impl CameraFile {
    /// Reads the file; says so if the image size had to be assumed.
    pub fn read(&self) -> Result<Views> {
        let views = Views::read(&self.cameras, self.resolution)?;
        if views.resolution_source == ResolutionSource::Assumed {
            let [w, h] = views.frames[0].camera.resolution;
            let path = self.cameras.display();
            eprintln!(
                "note: {path} states no image size and its images are not there: assuming {w} x {h} (--resolution)"
            );
        }
        Ok(views)
    }
}

/// A camera file, or the cameras that the model brings along.
#[derive(Args)]
pub struct CameraOptions {
    /// transforms.json with intrinsics and camera-to-world poses (OpenGL axes) [default: the cameras of the model, if it has
    /// some]
    #[arg(long, value_name = "JSON")]
    pub cameras: Option<PathBuf>,

    /// Horizontal angle of view of the model's own cameras, degrees
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov, conflicts_with = "cameras")]
    pub fov: Option<f64>,

    /// Image size, W or WxH [default: from the camera file, else from its first image, else 400x400]
    #[arg(long, value_name = "SIZE", value_parser = parse_resolution)]
    pub resolution: Option<[u32; 2]>,
}

impl CameraOptions {
    /// Reads the camera file, or asks the model `name`.
    pub fn read(&self, model: &dyn RadianceField, name: &str) -> Result<Views> {
        if let Some(cameras) = &self.cameras {
            return CameraFile { cameras: cameras.clone(), resolution: self.resolution }.read();
        }
        let intrinsics = Intrinsics { fov_x: self.fov.map(f64::to_radians), resolution: self.resolution };
        let cameras = model.cameras(&intrinsics)?.ok_or_else(|| {
            Error::setting(
                "--cameras",
                "a transforms.json, as this model brings no cameras",
                format!("none for `{name}`"),
            )
        })?;
        let frame = |(i, camera)| Frame { camera, name: format!("pose {i}"), image: PathBuf::new() };
        Ok(Views {
            path: PathBuf::from(name),
            frames: cameras.into_iter().enumerate().map(frame).collect(),
            resolution_source: self.resolution.map_or(ResolutionSource::Assumed, |_| ResolutionSource::Requested),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_without_cameras_needs_a_camera_file() {
        let options = CameraOptions { cameras: None, fov: None, resolution: None };
        let scene = crate::field::VoxelGrid::bake(&crate::field::ClosedForm::ball(), [2; 3], Vec3::Z);
        let error = options.read(&scene, "ball.npz").unwrap_err().to_string();
        assert!(error.contains("--cameras") && error.contains("ball.npz"), "{error}");
        let error = crate::field::open_in("scene:ball", Some(Coordinates::Blender)).err().unwrap().to_string();
        assert!(error.contains("--coordinates") && error.contains("scene:ball"), "{error}");
    }
}
