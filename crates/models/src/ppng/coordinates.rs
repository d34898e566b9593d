//! Scene coordinates for a model whose file has its own.
//!
//! Letters: `x` scene position in the chosen coordinates, `p` position in those of the file. The latter are
//! instant-ngp's, in which the object lies in [0, 1]³. For Blender coordinates p = R (s x) + ½, with s = 0.33
//! and R cycling the axes.

use std::ops::Mul;

use glam::{DMat3, DVec3, Vec3};

use octobayes::geometry::{Aabb, Camera};
use octobayes_data::NGP_SCALE;

/// Scene units and axes in which a model is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coordinates {
    /// The file's own: the object region is [0, 1]³.
    #[default]
    Ngp,
    /// Coordinates of the NeRF-synthetic transforms.json files: p = cycle(0.33 x) + 0.5.
    Blender,
}

impl Coordinates {
    /// All of them, the default first.
    pub const ALL: [Self; 2] = [Self::Ngp, Self::Blender];

    /// The name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ngp => "ngp",
            Self::Blender => "blender",
        }
    }

    /// Length of a scene unit in file units.
    ///
    /// A density per file unit times this is the density per scene unit, which keeps optical depth the same.
    #[must_use]
    pub const fn scale(self) -> f64 {
        match self {
            Self::Ngp => 1.0,
            Self::Blender => NGP_SCALE,
        }
    }

    /// p − ½ for a scene position.
    #[inline]
    pub(super) fn centered(self, x: Vec3) -> Vec3 {
        match self {
            Self::Ngp => x - 0.5,
            Self::Blender => NGP_SCALE as f32 * self.direction(x),
        }
    }

    /// Expresses a scene direction in the file's axes.
    #[inline]
    pub(super) fn direction(self, d: Vec3) -> Vec3 {
        match self {
            Self::Ngp => d,
            Self::Blender => Vec3::new(d.y, d.z, d.x),
        }
    }

    /// Expresses a file direction in the scene's axes.
    fn inverse_direction(self, d: DVec3) -> DVec3 {
        match self {
            Self::Ngp => d,
            Self::Blender => DVec3::new(d.z, d.x, d.y),
        }
    }

    /// Turns derivatives by c = p − ½ along its three axes into derivatives by scene position.
    #[inline]
    pub(super) fn gradient<T: Mul<f32, Output = T> + Copy>(self, [x, y, z]: [T; 3]) -> [T; 3] {
        match self {
            Self::Ngp => [x, y, z],
            Self::Blender => [z, x, y].map(|d| d * NGP_SCALE as f32),
        }
    }

    /// The cube of the given side around p = ½, in scene coordinates.
    pub(super) fn cube(self, side: f64) -> Aabb {
        match self {
            Self::Ngp => Aabb::new(DVec3::splat(0.5 - 0.5 * side), DVec3::splat(0.5 + 0.5 * side))
                .expect("the side is positive and finite"),
            Self::Blender => Aabb::centered_cube(0.5 * side / NGP_SCALE),
        }
    }

    /// Position and axes of a scene camera (x right, y up, z back), given the file's pose (x right, y down, z forward).
    pub(super) fn pose(self, axes: DMat3, position: DVec3) -> (DVec3, DMat3) {
        let position = match self {
            Self::Ngp => position,
            Self::Blender => self.inverse_direction(position - 0.5) / NGP_SCALE,
        };
        let [right, down, forward] = [axes.x_axis, axes.y_axis, axes.z_axis].map(|a| self.inverse_direction(a));
        (position, DMat3::from_cols(right, -down, -forward))
    }

    /// A camera with square pixels and the principal point at the image centre.
    pub(super) fn camera(self, (axes, position): (DMat3, DVec3), fov_x: f64, resolution: [u32; 2]) -> Camera {
        let (position, axes) = self.pose(axes, position);
        let looking = Camera::look_at(position, position - axes.z_axis, axes.y_axis, fov_x, resolution);
        Camera { axes, ..looking }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blender_pose_goes_through_the_file_and_back() {
        // The convention of instant-ngp's README: negate columns 1 and 2, t * 0.33 + 0.5, cycle the rows to (y, z, x).
        let camera = Camera::look_at(DVec3::new(2.0, -3.0, 1.5), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let cycle = |v: DVec3| DVec3::new(v.y, v.z, v.x);
        let columns = [camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis].map(cycle);
        let file = (DMat3::from_cols(columns[0], columns[1], columns[2]), cycle(camera.position * 0.33 + 0.5));
        let found = Coordinates::Blender.camera(file, 0.7, [40, 30]);
        assert!((found.position - camera.position).length() < 1e-14 && found.axes.abs_diff_eq(camera.axes, 1e-15));
        assert_eq!((found.focal, found.center), (camera.focal, camera.center));

        // A ray meets the same file positions in both coordinates.
        let own = Coordinates::Ngp.camera(file, 0.7, [40, 30]);
        let [a, b] = [found, own].map(|c| c.ray(7.0, 11.0));
        let in_blender = Coordinates::Blender.centered(a.at(2.0).as_vec3());
        let in_file = Coordinates::Ngp.centered(b.at(2.0 * Coordinates::Blender.scale()).as_vec3());
        assert!((in_blender - in_file).length() < 1e-6, "{in_blender} {in_file}");
        let (da, db) = (Coordinates::Blender.direction(a.direction.as_vec3()), b.direction.as_vec3());
        assert!((da - db).length() < 1e-6);
    }
}
