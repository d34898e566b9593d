//! The surfaces that cameras see, as points.

use std::path::Path;

use glam::Vec3;
use rayon::prelude::*;

use super::axes::principal_axes;
use super::leaves::code;
use super::ply::{PlyWriter, SURFACE};
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes::render::{Renderer, Tracer, VolumeRenderer};
use octobayes::uncertainty::{Matrices, UncertaintyField};

/// Points per query.
const CHUNK: usize = 1 << 16;

/// Points on surfaces: where rays of cameras lose half of their light, if they lose as much.
#[derive(Debug, Clone, Default)]
pub struct Surfaces {
    /// `[n]`: scene units.
    pub positions: Vec<Vec3>,
    /// `[n]`: unit vectors against the gradient of density, on the camera's side; without a density, to the camera.
    pub normals: Vec<Vec3>,
    /// `[n]`: colours of the pixels without what lies behind, in [0, 1].
    pub colors: Vec<Vec3>,
    /// `[n]`: index of the camera.
    pub cameras: Vec<u32>,
    /// Pixels looked at, of each camera.
    pub pixels: Vec<u64>,
}

impl Surfaces {
    /// Default number of pixels.
    pub const PIXELS: u64 = 400_000;
}

/// Looks at every k-th pixel of every k-th row of all cameras, with the least k that makes it at most `pixels` or so.
///
/// # Errors
/// [`octobayes::Error::Interrupted`] only.
pub fn surfaces(
    renderer: &dyn Renderer,
    cameras: &[Camera],
    offset: f64,
    pixels: u64,
    monitor: &dyn Monitor,
) -> Result<Surfaces> {
    let total: u64 = cameras.iter().map(Camera::pixels).sum();
    let stride = ((total as f64 / pixels as f64).sqrt().ceil() as u32).max(1);
    let strided: Vec<Camera> = cameras.iter().map(|camera| camera.strided(stride, offset)).collect();
    monitor.begin("rows", strided.iter().map(|camera| u64::from(camera.resolution[1])).sum());
    let mut found = Surfaces::default();
    let background = renderer.background();
    for (k, (whole, camera)) in (0..).zip(cameras.iter().zip(&strided)) {
        let view = renderer.strided_image(whole, stride, offset, &[], monitor)?;
        let width = camera.resolution[0] as usize;
        found.pixels.push(camera.pixels());
        for (i, pixel) in view.pixels.iter().enumerate().filter(|(_, pixel)| pixel.opacity > 0.5) {
            let ray = camera.ray((i % width) as f64 + offset, (i / width) as f64 + offset);
            found.positions.push(ray.at(pixel.median_depth).as_vec3());
            // The camera's side, until the gradient is known.
            found.normals.push(-ray.direction.as_vec3());
            found.colors.push(((pixel.color - (1.0 - pixel.opacity) * background) / pixel.opacity).as_vec3());
            found.cameras.push(k);
        }
    }
    monitor.end();
    check(monitor)?;
    if let Some(VolumeRenderer { tracer, .. }) = renderer.marched() {
        let Surfaces { positions, normals, .. } = &mut found;
        let chunks = positions.par_chunks(CHUNK).zip(normals.par_chunks_mut(CHUNK));
        chunks.for_each(|(positions, normals)| against_gradient(tracer, positions, normals));
    }
    Ok(found)
}

/// Replaces directions to the camera by normals: the negative gradient of density, on the same side. Where density does
/// not change, the direction stays.
fn against_gradient(tracer: &Tracer, positions: &[Vec3], normals: &mut [Vec3]) {
    let step = tracer.marcher.step as f32;
    let bounds = &tracer.marcher.bounds;
    let around = |x: Vec3| {
        [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(move |axis| [-step, step].map(|h| bounds.clamp(x + h * axis)))
    };
    let positions: Vec<Vec3> = positions.iter().flat_map(|&x| around(x)).collect();
    let mut densities = vec![0.0; positions.len()];
    tracer.field.densities(&positions, &mut densities);
    for (normal, d) in normals.iter_mut().zip(densities.chunks_exact(6)) {
        let gradient = Vec3::new(d[1] - d[0], d[3] - d[2], d[5] - d[4]);
        if let Some(unit) = gradient.try_normalize() {
            *normal = if unit.dot(*normal) > 0.0 { unit } else { -unit };
        }
    }
}

/// Further properties of a point: whether it was seen, and the index of the camera that shows it.
const POINT: [(&str, &str); 2] = [("float", "scalar_seen"), ("float", "scalar_camera")];

/// Axes of the ellipsoids: three vectors, the longest first, as long as one standard deviation.
const AXES: [(&str, &str); 9] = [
    ("float", "scalar_axis_1_x"),
    ("float", "scalar_axis_1_y"),
    ("float", "scalar_axis_1_z"),
    ("float", "scalar_axis_2_x"),
    ("float", "scalar_axis_2_y"),
    ("float", "scalar_axis_2_z"),
    ("float", "scalar_axis_3_x"),
    ("float", "scalar_axis_3_y"),
    ("float", "scalar_axis_3_z"),
];

/// Writes the points with their U, and the axes of the covariance there if its matrices are given.
///
/// # Errors
/// If the file cannot be written.
pub fn write_points(
    path: &Path,
    surfaces: &Surfaces,
    field: &UncertaintyField,
    matrices: Option<&Matrices>,
) -> Result<()> {
    let axes = if matrices.is_some() { &AXES[..] } else { &[] };
    let properties = [&SURFACE[..], &POINT, axes].concat();
    let comments = [format!("surfaces of training views; {}", field.record().scale.quantity())];
    let mut ply = PlyWriter::create(path, &comments, &[("vertex", surfaces.positions.len(), &properties)])?;
    for first in (0..surfaces.positions.len()).step_by(CHUNK) {
        let chunk = first..(first + CHUNK).min(surfaces.positions.len());
        let answers = field.answers(&surfaces.positions[chunk.clone()]);
        let matrices = matrices.map(|matrices| matrices.at(&surfaces.positions[chunk.clone()]));
        for (i, found) in chunk.zip(&answers) {
            ply.surface(surfaces.positions[i], surfaces.normals[i], surfaces.colors[i], &found.estimate)?;
            let seen = if found.ray_coverage.is_some() { f32::from(code(found.observability)) } else { f32::NAN };
            ply.floats([seen, surfaces.cameras[i] as f32])?;
            if let Some(matrices) = &matrices {
                let axes = principal_axes(matrices[i % CHUNK]);
                ply.floats(axes.into_iter().flat_map(|axis| axis.as_vec3().to_array()))?;
            }
        }
    }
    ply.finish()
}
