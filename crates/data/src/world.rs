//! Frames that training programs make of a data set's world, each a similarity of it.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

pub use super::nerfstudio::frame_beside;
use super::views::Views;
use super::{colmap, nerfstudio};
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::metrics::median;

/// x ↦ scale · (rotation · x + translation).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Turns.
    pub rotation: DMat3,
    /// Moves, before it scales.
    pub translation: DVec3,
    /// Scales.
    pub scale: f64,
}

impl Similarity {
    /// Changes nothing.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, scale: 1.0 };

    /// Where a point goes.
    #[must_use]
    pub fn point(&self, x: DVec3) -> DVec3 {
        self.scale * (self.rotation * x + self.translation)
    }

    /// Where a camera goes.
    #[must_use]
    pub fn camera(&self, camera: &Camera) -> Camera {
        Camera { position: self.point(camera.position), axes: self.rotation * camera.axes, ..*camera }
    }

    /// This after a rigid motion.
    fn after(&self, before: &Self) -> Self {
        let translation = self.rotation * before.translation + self.translation;
        Self { rotation: self.rotation * before.rotation, translation, ..*self }
    }

    /// As nerfstudio writes a run's.
    #[must_use]
    pub fn to_json(&self) -> String {
        let row = |k: usize| {
            let [x, y, z] = self.rotation.row(k).to_array();
            format!("[{x:.9}, {y:.9}, {z:.9}, {:.9e}]", self.translation[k])
        };
        format!("{{\"transform\": [{}, {}, {}], \"scale\": {:.9e}}}", row(0), row(1), row(2), self.scale)
    }
}

/// A frame in which a model may lie, with its name and where points of the cameras' own frame are in it.
pub type NamedFrame = (&'static str, Similarity);

/// Points of COLMAP, and frames in which a model may lie that was trained on the cameras of `path`, each with its name
/// and where the points are in it. The first is the cameras' own. None if there are too few points.
///
/// # Errors
/// If cameras or points cannot be read.
pub fn frames_of_training(path: &Path) -> Result<(Vec<NamedFrame>, Vec<DVec3>)> {
    let is_json = nerfstudio::is_json(path);
    let place = if is_json { path.parent().unwrap_or(Path::new("")) } else { path };
    let place = if place.as_os_str().is_empty() { Path::new(".") } else { place };
    // A folder of several models has none of its own.
    let points = colmap::scene_points(place).unwrap_or_default();
    if points.len() < MIN_POINTS || nerfstudio::is_frame_of_run(path) || is_json && !path.ends_with("transforms.json") {
        return Ok((Vec::new(), Vec::new()));
    }
    let points: Vec<DVec3> = points.iter().map(|point| point.position).collect();
    let mut cameras = Views::read(path, None)?.cameras();
    let own = if is_json { nerfstudio::applied(path)? } else { (Similarity::IDENTITY, 1.0) };
    let (mut frames, mut saved) = (vec![("their own", own.0)], own.0);
    if !is_json {
        let gsplat = normalised_by_gsplat(&cameras, &points);
        frames.extend(gsplat.into_iter().map(|frame| ("gsplat's (normalize_world_space)", frame)));
        // nerfstudio's reader of COLMAP turns z up first.
        let rotation = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y);
        saved = Similarity { rotation, ..Similarity::IDENTITY };
        cameras.iter_mut().for_each(|camera| *camera = saved.camera(camera));
    }
    if own.1 == 1.0 {
        frames.push(("nerfstudio's default", nerfstudio::default_frame(&cameras).after(&saved)));
    }
    Ok((frames, points))
}

/// Fewer points determine no principal axes.
const MIN_POINTS: usize = 10;

/// The frame that gsplat makes of a COLMAP model (`normalize_world_space`, its default): upright as cameras are on
/// average, around the median of what they look at, in median distances from there; then principal axes of the points.
/// Their signs are those of a library, so that four frames are possible.
fn normalised_by_gsplat(cameras: &[Camera], points: &[DVec3]) -> Vec<Similarity> {
    let up = cameras.iter().map(|camera| camera.axes.y_axis).sum::<DVec3>().normalize_or(DVec3::Z);
    // Up becomes OpenCV's, −y.
    let rotation = DMat3::from_quat(DQuat::from_rotation_arc(up, DVec3::NEG_Y));
    let nearest: Vec<DVec3> = cameras
        .iter()
        .map(|camera| {
            let (position, forward) = (rotation * camera.position, rotation * -camera.axes.z_axis);
            position - position.dot(forward) * forward
        })
        .collect();
    let translation = -middle(&nearest);
    let distances = cameras.iter().map(|camera| (rotation * camera.position + translation).length());
    let upright = Similarity { rotation, translation, scale: 1.0 / median(distances) };
    let placed: Vec<DVec3> = points.iter().map(|point| upright.point(*point)).collect();
    let centre = middle(&placed);
    let principal = principal_axes(&placed);
    let signs = [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]];
    let frame = |signs: [f64; 3]| {
        let turn = DMat3::from_diagonal(DVec3::from(signs)) * principal;
        let translation = turn * (upright.translation - centre / upright.scale);
        Similarity { rotation: turn * upright.rotation, translation, ..upright }
    };
    signs.into_iter().map(frame).filter(|frame| frame.rotation.is_finite() && frame.scale.is_finite()).collect()
}

/// The median along each axis.
fn middle(points: &[DVec3]) -> DVec3 {
    DVec3::from([0, 1, 2].map(|k| median(points.iter().map(|point| point[k]))))
}

/// Principal axes of points as rows, from the longest, right-handed: Jacobi's rotations of their covariance.
fn principal_axes(points: &[DVec3]) -> DMat3 {
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let outer = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
    let mut a = points.iter().map(|point| outer(*point - mean)).fold(DMat3::ZERO, |sum, m| sum + m);
    let mut axes = DMat3::IDENTITY;
    for (p, q) in [(0, 1), (0, 2), (1, 2)].into_iter().cycle().take(60) {
        let angle = 0.5 * (2.0 * a.col(q)[p]).atan2(a.col(q)[q] - a.col(p)[p]);
        let mut turn = DMat3::IDENTITY;
        turn.col_mut(p)[p] = angle.cos();
        turn.col_mut(q)[q] = angle.cos();
        turn.col_mut(p)[q] = -angle.sin();
        turn.col_mut(q)[p] = angle.sin();
        a = turn.transpose() * a * turn;
        axes *= turn;
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a.col(j)[j].total_cmp(&a.col(i)[i]));
    let [x, y, z] = order.map(|k| axes.col(k));
    let x = if DMat3::from_cols(x, y, z).determinant() < 0.0 { -x } else { x };
    DMat3::from_cols(x, y, z).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras on an arc, points, and the frame that gsplat's own normalize.py makes of them (`align_principal_axes`
    /// after `similarity_from_cameras`).
    #[test]
    fn one_of_four_frames_is_what_gsplat_computes() {
        let camera = |i: u32| {
            let angle = 0.4 * f64::from(i);
            let eye = DVec3::new(2.0 * angle.cos() + 0.5, 2.0 * angle.sin() - 0.3, 0.7 + 0.1 * f64::from(i));
            Camera::look_at(eye, DVec3::new(0.1, 0.2, 0.05 * f64::from(i)), DVec3::Z, 0.7, [8, 8])
        };
        let cameras: Vec<Camera> = (0..5).map(camera).collect();
        let points = [
            [0.646, 0.511, 0.266],
            [-1.003, 0.553, 0.289],
            [-0.237, 0.391, 0.273],
            [0.594, 0.114, 0.309],
            [-0.436, 0.019, 0.104],
            [0.899, 0.12, 0.142],
            [-0.482, -0.029, 0.202],
            [0.024, 0.747, 0.401],
            [-2.411, -0.845, 0.165],
            [-0.122, 0.207, 0.243],
            [2.418, -0.456, 0.124],
            [2.343, 0.423, 0.333],
        ];
        let frames = normalised_by_gsplat(&cameras, &points.map(DVec3::from));
        // Where the origin and the ends of the three axes go.
        let expected = [
            [0.0267547492881906, -0.1425487479737505, -0.09213210169708133],
            [0.45146183015806735, -0.17752157279511865, -0.08978172139925582],
            [0.06166977208161875, 0.2770287571763102, -0.15801370504678483],
            [0.029847312442744606, -0.07669781023853567, 0.32888905852775874],
        ];
        let ends = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let off = |frame: &Similarity| {
            let distances = ends.iter().zip(expected).map(|(x, to)| frame.point(*x).distance(to.into()));
            distances.fold(0.0, f64::max)
        };
        let off: Vec<f64> = frames.iter().map(off).collect();
        assert_eq!(off.iter().filter(|off| **off < 1e-9).count(), 1, "{off:?}");
        assert!((frames[0].scale - 0.426_151_061_602_036_25).abs() < 1e-12, "{frames:?}");
        assert!(frames.iter().all(|frame| (frame.rotation.determinant() - 1.0).abs() < 1e-12), "{frames:?}");
    }
}
