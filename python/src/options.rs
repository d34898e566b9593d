//! Settings and cameras as Python hands them over.

use numpy::PyReadonlyArray2;
use octobayes::dataset::rigid_pose;
use octobayes::estimate::{GridKind, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Distortion, Domain, Norm};
use octobayes::glam::{DMat3, DVec3, Vec3};
use octobayes::posterior::{Covariance, Criterion, Prior};
use octobayes::rays::Pixels;
use octobayes::render::{GradientMethod, RayAverage};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::OrRaise;

/// Keyword arguments that were checked in Python; what is absent or `None` was not given.
pub struct Options<'a, 'py>(pub &'a Bound<'py, PyDict>);

impl<'py> Options<'_, 'py> {
    /// The argument's value, if it was given.
    pub fn get<T: FromPyObjectOwned<'py>>(&self, name: &str) -> PyResult<Option<T>> {
        match self.0.get_item(name)? {
            Some(value) if !value.is_none() => value.extract::<T>().map(Some).map_err(Into::into),
            _ => Ok(None),
        }
    }

    /// The argument's value, or else `default`.
    pub fn or<T: FromPyObjectOwned<'py>>(&self, name: &str, default: T) -> PyResult<T> {
        Ok(self.get(name)?.unwrap_or(default))
    }

    /// The member of `all` that the argument names.
    fn choice<T: Copy>(&self, name: &str, all: &[(&str, T)]) -> PyResult<Option<T>> {
        self.get::<String>(name)?.map(|found| choose(name, &found, all)).transpose()
    }

    /// The members of `all` that the argument lists.
    fn choices<T: Copy>(&self, name: &str, all: &[(&str, T)]) -> PyResult<Option<Vec<T>>> {
        let found = self.get::<Vec<String>>(name)?;
        found.map(|found| found.iter().map(|found| choose(name, found, all)).collect()).transpose()
    }

    /// The settings of rays.
    pub fn rays(&self) -> PyResult<RaySettings> {
        let default = RaySettings::default();
        let pixels = self.choice("pixels", &[("random", Pixels::Random), ("sobol", Pixels::Sobol)])?;
        let methods = [
            ("finite-difference", GradientMethod::FiniteDifference),
            ("analytic", GradientMethod::Analytic),
            ("auto", GradientMethod::Auto),
            ("forward-difference", GradientMethod::ForwardDifference),
        ];
        Ok(self
            .image(default)?
            .rays(self.or("rays", default.rays)?)
            .pixels(pixels.unwrap_or(default.pixels))
            .seed(self.or("seed", default.seed)?)
            .gradient(self.choice("gradient", &methods)?.unwrap_or(default.gradient))
            .step(self.get("step")?)
            .cutoff(self.or("cutoff", default.cutoff)?))
    }

    /// How rays pass through the model, and `others`.
    pub fn image(&self, others: RaySettings) -> PyResult<RaySettings> {
        Ok(others
            .march_step(self.get("march_step")?)
            .background(self.or("background", others.background.to_array()).map(Vec3::from_array)?)
            .pixel_offset(self.get("pixel_offset")?)
            .occupancy(self.or("occupancy", others.occupancy)?))
    }

    /// The settings of the grid.
    pub fn grid(&self) -> PyResult<GridSettings> {
        let default = GridSettings::default();
        let grids = [("octree", GridKind::Octree), ("dense", GridKind::Dense)];
        let priors = [("uniform", Prior::Uniform), ("volume", Prior::Volume)];
        let criteria = [
            ("sensitivity", Criterion::Sensitivity),
            ("density", Criterion::Density),
            ("ray-count", Criterion::RayCount),
        ];
        let criteria = self.choices("refine", &criteria)?;
        Ok(default
            .grid(self.choice("grid", &grids)?.unwrap_or(default.grid))
            .level(self.or("level", default.level)?)
            .covariance(self.covariance()?.unwrap_or(default.covariance))
            .lambda(self.get("lambda_")?)
            .tolerance(self.or("tolerance", default.tolerance)?)
            .prior(self.choice("prior", &priors)?.unwrap_or(default.prior))
            .min_rays(self.or("min_rays", default.min_rays)?)
            .criteria(criteria.map_or(default.criteria, FromIterator::from_iter))
            .memory(self.get("memory")?)
            .surface_points(self.or("surface_points", default.surface_points)?)
            .keep_sums(self.or("keep_sums", false)?))
    }

    /// The covariance, if one was named.
    pub fn covariance(&self) -> PyResult<Option<Covariance>> {
        self.choice("covariance", &Covariance::ALL.map(|covariance| (covariance.name(), covariance)))
    }

    /// Several covariances.
    pub fn covariances(&self) -> PyResult<Option<Vec<Covariance>>> {
        self.choices("covariance", &Covariance::ALL.map(|covariance| (covariance.name(), covariance)))
    }

    /// Ray averages.
    pub fn ray_averages(&self) -> PyResult<Option<Vec<RayAverage>>> {
        self.choices("ray_average", &RayAverage::ALL.map(|average| (average.name(), average)))
    }

    /// The box, if there is one.
    pub fn bounds(&self) -> PyResult<Option<Aabb>> {
        self.get::<[[f64; 3]; 2]>("box")?.map(|[min, max]| Aabb::new(min.into(), max.into()).or_raise()).transpose()
    }

    /// The contraction, if there is one.
    pub fn contraction(&self) -> PyResult<Option<Domain>> {
        let norm = self.choice("contract", &[("l2", Norm::L2), ("linf", Norm::Linf)])?;
        let (Some(norm), Some([x, y, z, radius])) = (norm, self.get::<[f64; 4]>("inner")?) else { return Ok(None) };
        Domain::contracted(DVec3::new(x, y, z), radius, norm).or_raise().map(Some)
    }
}

/// The member of `all` with the name that was found.
pub fn choose<T: Copy>(name: &str, found: &str, all: &[(&str, T)]) -> PyResult<T> {
    let member = all.iter().find(|(known, _)| *known == found);
    member.map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<String> = all.iter().map(|(known, _)| format!("'{known}'")).collect();
        PyValueError::new_err(format!("{name}: expected {}, found '{found}'", known.join(", ")))
    })
}

/// Numbers of a camera: pose (row by row), focal lengths, principal point, image size, k1, k2, p1, p2.
pub const NUMBERS: usize = 26;

/// Cameras from rows of [`NUMBERS`].
///
/// # Errors
/// If a camera is impossible; the message names it.
pub fn cameras(rows: &PyReadonlyArray2<f64>) -> PyResult<Vec<Camera>> {
    let camera = |(i, row): (usize, &[f64; NUMBERS])| {
        let wrong = |what: &str, expected: &str, found: String| {
            PyValueError::new_err(format!("cameras[{i}], {what}: expected {expected}, found {found}"))
        };
        let (pose, rest) = row.split_at(16);
        let column = |k: usize| DVec3::new(pose[k], pose[4 + k], pose[8 + k]);
        let (axes, position) = (DMat3::from_cols(column(0), column(1), column(2)), column(3));
        let [fx, fy, cx, cy, w, h, k1, k2, p1, p2] = std::array::from_fn(|n| rest[n]);
        let side = |side: f64| if side.fract() == 0.0 && side >= 0.0 { side as u32 } else { 0 };
        let distortion = Distortion { k: [k1, k2], p: [p1, p2] };
        let camera =
            Camera { position, axes, focal: [fx, fy], center: [cx, cy], resolution: [side(w), side(h)], distortion };
        // A pose may come with a scale, as in files.
        let is_scaled = (axes.determinant() - 1.0).abs() > 1e-6;
        let last = pose[12..].iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6);
        let camera = if is_scaled || !last {
            let matrix: Vec<Vec<f64>> = pose.chunks(4).map(<[f64]>::to_vec).collect();
            let (position, axes) =
                rigid_pose(&matrix).map_err(|found| wrong("pose", "a 4x4 camera-to-world pose", found))?;
            Camera { position, axes, ..camera }
        } else {
            camera
        };
        camera.defect().map_or(Ok(camera), |defect| Err(wrong("camera", "one that takes pictures", defect)))
    };
    let numbers = rows.as_slice()?;
    numbers.as_chunks::<NUMBERS>().0.iter().enumerate().map(camera).collect()
}

/// The numbers of cameras, for [`cameras`].
pub fn numbers(cameras: &[Camera]) -> Vec<f64> {
    let of = |camera: &Camera| {
        let Camera { position: p, axes, focal, center, resolution: [w, h], distortion } = camera;
        let row = |k: usize| [axes.x_axis[k], axes.y_axis[k], axes.z_axis[k], p[k]];
        let pose = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]].concat();
        let size = [f64::from(*w), f64::from(*h)];
        [&pose[..], focal, center, &size, &distortion.k, &distortion.p].concat()
    };
    cameras.iter().flat_map(of).collect()
}
