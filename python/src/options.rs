//! Settings and cameras as Python hands them over.

use numpy::PyReadonlyArray2;
use octobayes::estimate::{GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Distortion, Domain, Norm};
use octobayes::glam::{DMat3, DVec3, Vec3};
use octobayes::posterior::{Covariance, Criterion};
use octobayes::rays::Pixels;
use octobayes::render::RayAverage;
use octobayes::uncertainty::Comparison;
use octobayes_clean::{Baking, Clean, Reason, Strength};
use octobayes_data::OfficialGrid;
use octobayes_data::{Selection, rigid_pose};
use octobayes_evaluation::{DepthFiles, Evaluation};
use octobayes_next_view::Settings;
use octobayes_session::{Choices, Resolution, Survey};
use octobayes_show::export::{MeshSettings, Surfaces};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::de::DeserializeOwned;
use serde_json::json;

use crate::errors::OrRaise;

/// Keyword arguments that were checked in Python; what is absent or `None` was not given.
pub struct Options<'a, 'py>(pub &'a Bound<'py, PyDict>);

impl<'py> Options<'_, 'py> {
    /// The argument's value, if it was given.
    pub fn get<T: FromPyObjectOwned<'py>>(&self, name: &str) -> PyResult<Option<T>> {
        match self.0.get_item(name)? {
            Some(value) if !value.is_none() => value.extract::<T>().map(Some).map_err(|error| {
                let error: PyErr = error.into();
                // A number that is too large for its type, or negative: Python's error does not name the argument.
                if error.is_instance_of::<PyOverflowError>(self.0.py()) {
                    return PyValueError::new_err(format!("{name}: expected a number within its range, found {value}"));
                }
                error
            }),
            _ => Ok(None),
        }
    }

    /// The argument's value, or else `default`.
    pub fn or<T: FromPyObjectOwned<'py>>(&self, name: &str, default: T) -> PyResult<T> {
        Ok(self.get(name)?.unwrap_or(default))
    }

    /// What the argument names.
    pub fn choice<T: DeserializeOwned>(&self, name: &str) -> PyResult<Option<T>> {
        self.get::<String>(name)?.map(|found| choose(name, &found)).transpose()
    }

    /// What the argument lists.
    fn list<T: DeserializeOwned>(&self, name: &str) -> PyResult<Option<Vec<T>>> {
        let found = self.get::<Vec<String>>(name)?;
        found.map(|found| found.iter().map(|found| choose(name, found)).collect()).transpose()
    }

    /// The settings of rays.
    pub fn rays(&self) -> PyResult<RaySettings> {
        let mut default = RaySettings::default();
        match self.get::<String>("rays") {
            Ok(Some(all)) if all == "all" => default.pixels = Pixels::Every,
            _ => default.rays = self.or("rays", default.rays)?,
        }
        Ok(self
            .image(default)?
            .seed(self.or("seed", default.seed)?)
            .gradient(self.choice("gradient")?.unwrap_or(default.gradient))
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

    /// The settings of the grid, but for those that [`Options::choices`] decide on.
    pub fn grid(&self) -> PyResult<GridSettings> {
        let default = GridSettings::default();
        let criteria = self.list::<Criterion>("refine")?;
        Ok(default
            .grid(self.choice("grid")?.unwrap_or(default.grid))
            .lambda(self.get("lambda_")?)
            .tolerance(self.or("tolerance", default.tolerance)?)
            .pooling(self.choice("pooling")?.unwrap_or(default.pooling))
            .criteria(criteria.map_or(default.criteria, FromIterator::from_iter))
            .memory(self.get("memory")?))
    }

    /// What the purpose or the model decides on, where it is not given.
    pub fn choices(&self) -> PyResult<Choices> {
        Ok(Choices {
            purpose: self.choice("for_")?,
            level: self.get("level")?,
            covariance: self.covariance()?,
            scale: self.choice("scale")?,
            noise: self.get("noise")?,
            keep_sums: self.get("keep_sums")?,
        })
    }

    /// The covariance, if one was named.
    pub fn covariance(&self) -> PyResult<Option<Covariance>> {
        self.choice("covariance")
    }

    /// Several covariances.
    pub fn covariances(&self) -> PyResult<Option<Vec<Covariance>>> {
        self.list("covariance")
    }

    /// Ray averages.
    pub fn ray_averages(&self) -> PyResult<Option<Vec<RayAverage>>> {
        self.list("ray_average")
    }

    /// The box, if there is one.
    pub fn bounds(&self) -> PyResult<Option<Aabb>> {
        self.get::<[[f64; 3]; 2]>("box")?.map(|[min, max]| Aabb::new(min.into(), max.into()).or_raise()).transpose()
    }

    /// What a field covers: all of space, contracted, or a box.
    pub fn domain(&self) -> PyResult<Option<Domain>> {
        match self.contraction()? {
            Some(contracted) => Ok(Some(contracted)),
            None => Ok(self.bounds()?.map(Domain::Box)),
        }
    }

    /// The size of images: a width, or both sides.
    pub fn resolution(&self) -> PyResult<Option<Resolution>> {
        let (width, height) = (self.get("width")?, self.get("height")?);
        Ok(width.map(|width| height.map_or(Resolution::Width(width), |height| Resolution::Size([width, height]))))
    }

    /// The frames that "all", a number of them or their numbers select.
    pub fn selection(&self) -> PyResult<Selection> {
        let Some(views) = self.0.get_item("views")?.filter(|views| !views.is_none()) else {
            return Ok(Selection::All);
        };
        Ok(match (views.extract::<usize>(), views.extract::<Vec<usize>>()) {
            (Ok(count), _) => Selection::Count(count),
            (_, Ok(mut indices)) => {
                indices.sort_unstable();
                indices.dedup();
                Selection::Indices(indices)
            }
            _ => Selection::BothParts,
        })
    }

    /// The contraction, if there is one.
    fn contraction(&self) -> PyResult<Option<Domain>> {
        let norm = self.choice::<Norm>("contract")?;
        let (Some(norm), Some([x, y, z, radius])) = (norm, self.get::<[f64; 4]>("inner")?) else { return Ok(None) };
        Domain::contracted(DVec3::new(x, y, z), radius, norm).or_raise().map(Some)
    }
}

/// What a text names, in the library's spelling.
pub fn choose<T: DeserializeOwned>(name: &str, found: &str) -> PyResult<T> {
    serde_json::from_value(json!(found)).map_err(|error| {
        // serde lists the known variants: "unknown variant `x`, expected `a` or `b`", or "one of `a`, `b`, `c`".
        let said = error.to_string().replace('`', "'");
        let known = said.split_once("expected ").map_or(&*said, |(_, known)| known.trim_start_matches("one of "));
        PyValueError::new_err(format!("{name}: expected {known}, found '{found}'"))
    })
}

/// Least number of points in most calls of a callable.
const BATCH: usize = 1 << 16;

/// The library's defaults as JSON, by the names of arguments.
#[pyfunction]
pub fn defaults() -> String {
    let (rays, grid, mesh) = (RaySettings::default(), GridSettings::default(), MeshSettings::default());
    let views = Settings::default();
    json!({
        "rays": rays.rays,
        "seed": rays.seed,
        "gradient": rays.gradient,
        "cutoff": rays.cutoff,
        "occupancy": rays.occupancy,
        "grid": grid.grid,
        "refine": grid.criteria.to_string(),
        "covariance": grid.covariance,
        "tolerance": grid.tolerance,
        "pooling": grid.pooling,
        "official_rays": OfficialGrid::DEFAULT_RAYS,
        "ray_average": RayAverage::default(),
        "depth_pattern": DepthFiles::PATTERN,
        "pixels": Surfaces::PIXELS,
        "clean_pixels": Clean::PIXELS,
        "clean_points": Baking::POINTS,
        "clean_strength": Strength::default(),
        "clean_strengths": Strength::ALL,
        "clean_reasons": Reason::ALL,
        "cells": mesh.resolution,
        "points": Comparison::POINTS,
        "stride": Evaluation::STRIDE,
        "probability": Evaluation::PROBABILITY,
        "batch": BATCH,
        "take": views.take,
        "gain": views.gain,
        "view_pixels": views.pixels,
        "depth_rays": Survey::RAYS,
    })
    .to_string()
}

/// Whether a run with these options keeps its sums.
#[pyfunction]
pub fn keeps_sums(options: &Bound<'_, PyDict>) -> PyResult<bool> {
    Ok(Options(options).choices()?.keeps_sums())
}

/// Numbers of a camera: pose (row by row), focal lengths, principal point, image size, k1, k2, k3, k4, p1, p2.
pub const NUMBERS: usize = 28;

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
        let [fx, fy, cx, cy, w, h, k1, k2, k3, k4, p1, p2] = std::array::from_fn(|n| rest[n]);
        let side = |side: f64| if side.fract() == 0.0 && side >= 0.0 { side as u32 } else { 0 };
        let distortion = Distortion { k: [k1, k2, k3, k4], p: [p1, p2] };
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
