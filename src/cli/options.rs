//! Options that several verbs share.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::{DVec3, Vec3};

use crate::dataset::{Frame, ResolutionSource, Views};
use crate::estimate::{GridKind, GridSettings, RaySettings};
use crate::field::{Coordinates, Intrinsics, RadianceField};
use crate::geometry::{Aabb, Domain, Norm};
use crate::io::AtomicFile;
use crate::posterior::{Covariance, Prior};
use crate::render::Occupancy;
use crate::uncertainty::{OfficialGrid, UncertaintyField};
use crate::{Error, Result};

use super::report::{self, Cost};

/// What images leave out changes a pixel by no more than this in front and behind: less than half a step of 8 bits.
const IMAGE_CUTOFF: f64 = 1e-4;

/// Numbers separated by commas.
fn numbers<const N: usize>(text: &str) -> std::result::Result<[f64; N], String> {
    let parts: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().map_err(|_| format!("`{part}` is not a number")))
        .collect::<std::result::Result<_, _>>()?;
    if parts.iter().any(|v| !v.is_finite()) {
        return Err("numbers must be finite".into());
    }
    <[f64; N]>::try_from(parts)
        .map_err(|parts| format!("expected {N} numbers separated by commas, found {}", parts.len()))
}

/// `x0,y0,z0,x1,y1,z1`.
pub fn parse_box(text: &str) -> std::result::Result<Aabb, String> {
    let [x0, y0, z0, x1, y1, z1] = numbers::<6>(text)?;
    Aabb::new(DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)).map_err(|e| e.to_string())
}

/// `offset,scale`.
pub fn parse_pair(text: &str) -> std::result::Result<[f64; 2], String> {
    numbers(text)
}

/// `low,high`.
pub fn parse_range(text: &str) -> std::result::Result<[f64; 2], String> {
    let [low, high] = numbers(text)?;
    if low < high { Ok([low, high]) } else { Err("the first number must be below the second".into()) }
}

/// `white`, `black` or `r,g,b`.
fn parse_background(text: &str) -> std::result::Result<Vec3, String> {
    match text {
        "white" => Ok(Vec3::ONE),
        "black" => Ok(Vec3::ZERO),
        _ => {
            let color = DVec3::from(numbers::<3>(text)?).as_vec3();
            if color.min_element() >= 0.0 && color.max_element() <= 1.0 {
                Ok(color)
            } else {
                Err("red, green and blue must be from 0 to 1".into())
            }
        }
    }
}

/// `W` or `WxH`.
pub fn parse_resolution(text: &str) -> std::result::Result<[u32; 2], String> {
    let side = |text: &str| match text.parse::<u32>() {
        Ok(side) if (1..=65_536).contains(&side) => Ok(side),
        _ => Err(format!("`{text}` is not a whole number of pixels from 1 to 65536")),
    };
    match text.split_once('x') {
        Some((w, h)) => Ok([side(w)?, side(h)?]),
        None => Ok([side(text)?; 2]),
    }
}

/// A finite number above 0.
pub fn parse_positive(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v.is_finite() => Ok(v),
        _ => Err("expected a finite number above 0".into()),
    }
}

/// A finite number from 0.
pub fn parse_non_negative(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v >= 0.0 && v.is_finite() => Ok(v),
        _ => Err("expected a finite number, 0 or more".into()),
    }
}

/// An angle of view in degrees.
fn parse_fov(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v < 180.0 => Ok(v),
        _ => Err("expected an angle above 0 and below 180 degrees".into()),
    }
}

impl ValueEnum for Covariance {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::Diagonal => "sum of 1/H_kk: the paper's; depends on how the axes are turned",
            Self::Trace => "1/(tr S/R + lambda): the official code's",
            Self::Block => "trace of the inverse 3x3 block: does not depend on the axes",
            Self::Normal => "inverse 3x3 block across the surface only: the part that can move depth",
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
}

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

/// A radiance field and how rays go through it.
#[derive(Args)]
pub struct ModelOptions {
    /// The trained field: a `.safetensors` MLP NeRF, a `.ppng` Plenoptic PNG, an `.npz` voxel grid (density, color, box), or
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

/// The part of space that a field covers.
#[derive(Args)]
pub struct DomainOptions {
    /// Box of the field: x0,y0,z0,x1,y1,z1 in scene units [default: the model's, if there
    /// is one]
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true, conflicts_with = "contract")]
    pub bounds: Option<Aabb>,

    /// Cover all of space, contracted outside --inner as in mip-NeRF 360: for unbounded scenes
    #[arg(long, value_enum, value_name = "NORM", requires = "inner")]
    pub contract: Option<Norm>,

    /// Centre and radius of the part that is not contracted: x,y,z,r in scene units
    #[arg(long, value_name = "BALL", value_parser = numbers::<4>, allow_hyphen_values = true, requires = "contract")]
    pub inner: Option<[f64; 4]>,
}

impl DomainOptions {
    /// What the options say, or the box of the model, if there is one.
    pub fn domain(&self, model: Option<Aabb>) -> Result<Domain> {
        match (self.contract, self.inner, self.bounds.or(model)) {
            (Some(norm), Some([x, y, z, radius]), _) => Domain::contracted(DVec3::new(x, y, z), radius, norm),
            (.., Some(bounds)) => Ok(Domain::Box(bounds)),
            _ => Err(Error::setting("--box", "the box of the field, or --contract and --inner", "neither")),
        }
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

/// Which information to keep in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Keep {
    /// The 3x3 matrices too: another covariance can be chosen later
    Hessian,
    /// The deviations only
    Deviation,
}

/// How information becomes a field.
#[derive(Args)]
pub struct GridOptions {
    /// Where the field is written
    #[arg(short, long, value_name = "FIELD.oct")]
    pub output: PathBuf,

    /// Finest level: 2^level cells per axis, 1 to 16
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=16))]
    pub level: u8,

    /// What carries the field
    #[arg(long, value_enum, default_value = "octree")]
    pub grid: GridKind,

    /// Scalar read off the 3x3 matrices
    #[arg(long, value_enum, default_value = "diagonal")]
    pub covariance: Covariance,

    /// Prior precision, 1 / scene unit^2 [default: 1e-4 / 2^(3 level) per squared longest edge of the box]
    #[arg(long, value_name = "LAMBDA", value_parser = parse_positive)]
    pub lambda: Option<f64>,

    /// Largest change of log10 U that coarse leaves of the octree may cause; 0 keeps every vertex that any ray touched
    #[arg(long, value_name = "DECADES", default_value_t = 0.01, value_parser = parse_non_negative)]
    pub tolerance: f64,

    /// How the prior's precision depends on the size of cells
    #[arg(long, value_enum, default_value = "uniform")]
    pub prior: Prior,

    /// Pooling by evidence: where neighbourhoods have fewer rays than about this, vertices share what their neighbours saw; 0
    /// leaves every vertex by itself, as in the paper
    #[arg(long, value_name = "RAYS", default_value_t = 0.0, value_parser = parse_non_negative)]
    pub min_rays: f64,

    /// What to keep in the file [default: hessian for an octree, deviation for a dense grid]
    #[arg(long, value_enum)]
    pub keep: Option<Keep>,

    /// Merge leaves of the finished octree as long as log10 U changes by at most this, everywhere; keeps deviations only
    #[arg(long, value_name = "DECADES", value_parser = parse_positive)]
    pub coarsen: Option<f64>,

    /// Points on visible surfaces to keep in the file, for `compare`
    #[arg(long, value_name = "N", default_value_t = 16_384)]
    pub surface_points: usize,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

impl GridOptions {
    /// The library's settings.
    pub fn settings(&self) -> GridSettings {
        GridSettings {
            grid: self.grid,
            level: self.level,
            covariance: self.covariance,
            lambda: self.lambda,
            tolerance: self.tolerance,
            prior: self.prior,
            min_rays: self.min_rays,
            surface_points: self.surface_points,
        }
    }

    /// Makes sure, before any work, that the output can be made and written.
    pub fn check_output(&self) -> Result<()> {
        if self.coarsen.is_some() && (self.grid == GridKind::Dense || self.covariance == Covariance::Trace) {
            let found = format!(
                "{} and `{}`",
                if self.grid == GridKind::Dense { "dense" } else { "octree" },
                self.covariance.name()
            );
            return Err(Error::setting("--coarsen", "an octree with covariance `diagonal` or `block`", found));
        }
        AtomicFile::create(&self.output).map(drop)
    }

    /// Writes a finished field, with or without its information, and reports it.
    pub fn write(&self, field: UncertaintyField, cost: &Cost) -> Result<()> {
        let keep = self.keep.unwrap_or(match self.grid {
            GridKind::Dense => Keep::Deviation,
            GridKind::Octree => Keep::Hessian,
        });
        let field = match (self.coarsen, keep) {
            (Some(epsilon), _) => field.coarsened(epsilon)?,
            (None, Keep::Deviation) => field.without_evidence(),
            (None, Keep::Hessian) => field,
        };
        field.write(&self.output)?;
        report::finished(&field, cost, self.json)
    }
}

/// The box of an official `.npy`, which does not say.
#[derive(Args)]
pub struct OfficialOptions {
    /// Box of the official code's `.npy` grids: x0,y0,z0,x1,y1,z1 in scene units
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub bounds: Option<Aabb>,

    /// Rays summed in the official code's `.npy` grids
    #[arg(long, default_value_t = OfficialGrid::DEFAULT_RAYS, value_parser = clap::value_parser!(u64).range(1..))]
    pub rays: u64,
}

impl OfficialOptions {
    /// Reads a field: `.oct`, or the official code's `.npy`.
    pub fn read(&self, path: &Path) -> Result<UncertaintyField> {
        match path.extension().and_then(|e| e.to_str()) {
            Some("npy") => {
                let bounds = self.bounds.ok_or_else(|| {
                    let found = format!("{} without one", path.display());
                    Error::setting("--box", "the box of the official grid, which its file does not name", found)
                })?;
                OfficialGrid { bounds, rays: self.rays, lambda: None }.read(path)
            }
            _ => UncertaintyField::read(path),
        }
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

    #[test]
    fn texts_become_settings_or_reasons() {
        assert!(parse_box("-1,-1,-1,1,1,1").is_ok());
        assert!(parse_box("1,1,1,-1,-1,-1").unwrap_err().contains("min < max"));
        assert!(parse_box("1,2,3").unwrap_err().contains("6 numbers"));
        assert_eq!(parse_background("0,0.5,1"), Ok(Vec3::new(0.0, 0.5, 1.0)));
        assert!(parse_background("0,0.5,2").is_err() && parse_background("red").is_err());
        assert_eq!(parse_resolution("80x60"), Ok([80, 60]));
        assert!(parse_resolution("0").is_err() && parse_resolution("8x").is_err());
        assert!(parse_fov("60").is_ok() && parse_fov("180").is_err() && parse_fov("nan").is_err());
        assert!(parse_positive("-1").is_err() && parse_positive("nan").is_err() && parse_non_negative("0").is_ok());
    }
}
