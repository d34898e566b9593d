//! Pinhole cameras in the OpenGL convention.
//!
//! Camera axes: x right, y up, view along −z. Pixel (column i, row j) has row 0 at the top.

use glam::{DMat3, DVec3};

use super::{Distortion, Mask, Ray};

/// Largest accepted image: 100 megapixels.
pub const MAX_PIXELS: f64 = 1e8;
/// Largest accepted image side; a larger one means a damaged file.
pub const MAX_SIDE: f64 = 65_536.0;
/// Largest distance of an image corner from the optical axis, on the plane at depth 1. Beyond it there is no
/// picture, and the length of a ray overflows.
pub const MAX_REACH: f64 = 1e6;
/// Largest accepted [`skew`] of camera axes. Poses are written with 6 to 8 digits; optimised ones drift a
/// little more.
pub const MAX_SKEW: f64 = 1e-2;

/// Largest share of pixels that may lie beyond the fold of a lens.
const MAX_SHARE_WITHOUT_RAYS: f64 = 0.02;

/// How far axes A are from a rotation: the largest entry of AᵀA − 1.
#[must_use]
pub fn skew(axes: DMat3) -> f64 {
    let rest = axes.transpose() * axes - DMat3::IDENTITY;
    rest.to_cols_array().iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// A pinhole camera: pose and intrinsics in pixels.
///
/// ```
/// use octobayes::geometry::Camera;
/// use octobayes::glam::DVec3;
///
/// // 60 degrees wide, 4 units away from the origin, z up.
/// let camera = Camera::look_at(DVec3::new(4.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z, 60_f64.to_radians(), [640, 480]);
/// // The ray through the image centre runs towards the target.
/// let ray = camera.ray(320.0, 240.0);
/// assert!((ray.direction - DVec3::NEG_X).length() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Optical centre, scene units.
    pub position: DVec3,
    /// Camera-to-world: columns right, up, back.
    pub axes: DMat3,
    /// Focal lengths along x and y, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels from the top left corner of the image.
    pub center: [f64; 2],
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// How the lens distorts ideal image coordinates.
    pub distortion: Distortion,
}

impl Camera {
    /// Angle of a pixel of some cameras, radians: the median of 1 / focal length, the shorter of the two; `None` without
    /// cameras.
    #[must_use]
    pub fn pixel_angle(cameras: &[Self]) -> Option<f64> {
        let mut angles: Vec<f64> = cameras.iter().map(|camera| 1.0 / camera.focal[0].min(camera.focal[1])).collect();
        angles.sort_unstable_by(f64::total_cmp);
        angles.get(angles.len() / 2).copied()
    }

    /// A camera at `eye` that looks at `target`, with the principal point at the image centre.
    ///
    /// `fov_x` is the horizontal angle of view in radians. `up` must not be parallel to the view direction.
    #[must_use]
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov_x: f64, resolution: [u32; 2]) -> Self {
        let back = (eye - target).normalize();
        let right = up.cross(back).normalize();
        let focal = 0.5 * f64::from(resolution[0]) / (0.5 * fov_x).tan();
        Self {
            position: eye,
            axes: DMat3::from_cols(right, back.cross(right), back),
            focal: [focal; 2],
            center: [0.5 * f64::from(resolution[0]), 0.5 * f64::from(resolution[1])],
            resolution,
            distortion: Distortion::default(),
        }
    }

    /// The ray through image coordinates `(x, y)` in pixels. The centre of pixel (i, j) is `(i + ½, j + ½)`.
    #[must_use]
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let seen = [(x - self.center[0]) / self.focal[0], (y - self.center[1]) / self.focal[1]];
        let [x, y] = self.distortion.undistort(seen);
        let direction = DVec3::new(x, -y, -1.0);
        Ray::new(self.position, self.axes * direction)
    }

    /// Says if the lens folds the image over, so that many of its pixels have no ray: coefficients that no lens has.
    ///
    /// Calibrations may do so in the outermost corners, where nothing was measured: one pixel in fifty is let pass,
    /// with the ray of a neighbour.
    #[must_use]
    pub fn folds_over(&self) -> Option<String> {
        const SIDE: usize = 33;
        if self.distortion == Distortion::default() {
            return None;
        }
        let has_ray = |i: usize| {
            let [u, v] = [i % SIDE, i / SIDE].map(|n| n as f64 / (SIDE - 1) as f64);
            let at = [u * f64::from(self.resolution[0]), v * f64::from(self.resolution[1])];
            self.distortion.is_invertible([0, 1].map(|k| (at[k] - self.center[k]) / self.focal[k]))
        };
        let without = (0..SIDE * SIDE).filter(|&i| !has_ray(i)).count() as f64 / (SIDE * SIDE) as f64;
        let percent = 100.0 * without;
        (without > MAX_SHARE_WITHOUT_RAYS)
            .then(|| format!("{}, which is not invertible for {percent:.0} % of the pixels", self.distortion))
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        u64::from(self.resolution[0]) * u64::from(self.resolution[1])
    }

    /// Image coordinates of a scene point and its depth along the view axis; `None` behind the camera.
    #[must_use]
    pub fn project(&self, x: DVec3) -> Option<([f64; 2], f64)> {
        let (ideal, depth) = self.ideal(x)?;
        Some((self.pixel(self.distortion.distort(ideal)), depth))
    }

    /// Where a lens without distortion puts a scene point, in focal lengths from the centre, and its depth.
    fn ideal(&self, x: DVec3) -> Option<([f64; 2], f64)> {
        let p = self.axes.transpose() * (x - self.position);
        let depth = -p.z;
        (depth > 0.0).then(|| ([p.x / depth, -p.y / depth], depth))
    }

    /// Image coordinates of a place in focal lengths from the centre.
    fn pixel(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.center[0] + self.focal[0] * x, self.center[1] + self.focal[1] * y]
    }

    /// Image coordinates and depth of a scene point as [`Camera::project`]; `None` outside the image, too. What a
    /// polynomial of the lens folds back into the image from far beside it is outside.
    #[must_use]
    pub fn project_inside(&self, x: DVec3) -> Option<([f64; 2], f64)> {
        let (ideal, depth) = self.ideal(x)?;
        let seen = self.distortion.distort(ideal);
        let at = self.pixel(seen);
        let is_inside = at.iter().zip(self.resolution).all(|(v, n)| (0.0..f64::from(n)).contains(v));
        let keeps_its_side = || self.distortion == Distortion::default() || self.distortion.keeps_its_side(ideal, seen);
        (is_inside && keeps_its_side()).then_some((at, depth))
    }

    /// What makes the camera impossible, or `None`. Meant for cameras read from files.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        let lens = self.distortion.k.iter().chain(&self.distortion.p);
        let finite = self.position.is_finite()
            && self.axes.is_finite()
            && self.focal.iter().chain(&self.center).chain(lens).all(|v| v.is_finite());
        let size = self.resolution.map(f64::from);
        let reach = |k: usize| self.center[k].abs().max((size[k] - self.center[k]).abs()) / self.focal[k];
        if !finite {
            Some("a number that is not finite".into())
        } else if size.iter().any(|side| !(1.0..=MAX_SIDE).contains(side)) || size[0] * size[1] > MAX_PIXELS {
            Some(format!("an image of {} x {} pixels", size[0], size[1]))
        } else if self.focal.iter().any(|f| *f <= 0.0) || [0, 1].iter().any(|&k| reach(k) >= MAX_REACH) {
            Some(format!("focal lengths {:?}, principal point {:?}", self.focal, self.center))
        } else if skew(self.axes) > MAX_SKEW || self.axes.determinant() <= 0.0 {
            Some(format!("axes that are no rotation, {:?}", self.axes.to_cols_array()))
        } else {
            self.folds_over()
        }
    }

    /// Checksum of everything that the rays of a run depend on: the cameras in their order, and their masks if any
    /// camera has one.
    #[must_use]
    pub fn checksum_with(cameras: &[Self], masks: &[Option<Mask>]) -> u32 {
        let cameras = Self::checksum(cameras);
        if masks.iter().all(Option::is_none) {
            return cameras;
        }
        let mut hasher = crc32fast::Hasher::new_with_initial(cameras);
        for mask in masks {
            hasher.update(&mask.as_ref().map_or(0, |mask| 1 | u64::from(mask.checksum()) << 1).to_le_bytes());
        }
        hasher.finalize()
    }

    /// Checksum of every number that the rays depend on; the order of the cameras counts.
    #[must_use]
    pub fn checksum(cameras: &[Self]) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for camera in cameras {
            let Distortion { k, p } = camera.distortion;
            let numbers =
                [&camera.position.to_array()[..], &camera.axes.to_cols_array(), &camera.focal, &camera.center];
            for number in numbers.into_iter().flatten().chain(&k).chain(&p) {
                hasher.update(&number.to_le_bytes());
            }
            camera.resolution.iter().for_each(|side| hasher.update(&side.to_le_bytes()));
        }
        hasher.finalize()
    }

    /// Checks whether images could not distinguish the two cameras.
    ///
    /// Rays through the corners and the centre of both images may differ by at most a quarter of a pixel of
    /// `self`. So may their origins, seen from a distance of `length` (scene units). The number of pixels
    /// does not count.
    #[must_use]
    pub fn is_like(&self, other: &Self, length: f64) -> bool {
        const PLACES: [[f64; 2]; 5] = [[0.5, 0.5], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let tolerance = 0.25 / self.focal[0].max(self.focal[1]);
        let direction = |camera: &Self, [x, y]: [f64; 2]| {
            let [w, h] = camera.resolution.map(f64::from);
            camera.ray(x * w, y * h).direction
        };
        (self.position - other.position).length() <= tolerance * length
            && PLACES.iter().all(|&at| (direction(self, at) - direction(other, at)).length() <= tolerance)
    }

    /// The camera whose pixel (i, j) has the ray of this one's pixel (i · stride, j · stride), both taken at
    /// `offset` within the pixel.
    #[must_use]
    pub fn strided(&self, stride: u32, offset: f64) -> Self {
        if stride == 1 {
            return *self;
        }
        let s = f64::from(stride);
        Self {
            focal: self.focal.map(|f| f / s),
            center: self.center.map(|c| offset + (c - offset) / s),
            resolution: self.resolution.map(|n| n.div_ceil(stride)),
            ..*self
        }
    }

    /// The same view with another image size.
    #[must_use]
    pub fn resized(&self, resolution: [u32; 2]) -> Self {
        let scale = [0, 1].map(|k| f64::from(resolution[k]) / f64::from(self.resolution[k]));
        Self {
            focal: [self.focal[0] * scale[0], self.focal[1] * scale[1]],
            center: [self.center[0] * scale[0], self.center[1] * scale[1]],
            resolution,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::array::{uniform2, uniform3, uniform4};
    use proptest::prelude::*;

    proptest! {
        /// Any pose, any lens of COLMAP's and nerfstudio's perspective cameras, any point on a ray.
        #[test]
        fn rays_of_every_lens_project_back_to_their_pixel(
            eye in uniform3(-10.0..10.0_f64),
            up in uniform3(0.1..1.0_f64),
            focal in uniform2(300.0..2000.0_f64),
            center in uniform2(-20.0..20.0_f64),
            k in uniform4(-0.3..0.3_f64),
            coefficients in 0..=4_usize,
            p in uniform2(-1e-2..1e-2_f64),
            is_tangential: bool,
            pixel in (0.0..640.0_f64, 0.0..480.0_f64),
            depth in 0.1..100.0_f64,
        ) {
            let (eye, up) = (DVec3::from(eye), DVec3::from(up));
            prop_assume!(eye.length() > 0.1 && eye.normalize().cross(up.normalize()).length() > 0.1);
            let k = std::array::from_fn(|i| if i < coefficients { k[i] } else { 0.0 });
            let camera = Camera {
                focal,
                center: [320.0 + center[0], 240.0 + center[1]],
                distortion: Distortion { k, p: if is_tangential { p } else { [0.0; 2] } },
                ..Camera::look_at(eye, DVec3::ZERO, up, 1.0, [640, 480])
            };
            let pixel = [pixel.0, pixel.1];
            // A pixel beyond the fold of a lens has no ray, one next to it no exact one.
            let seen = [0, 1].map(|i| (pixel[i] - camera.center[i]) / camera.focal[i]);
            prop_assume!(camera.distortion.is_invertible(seen.map(|v| 1.05 * v)));
            let (found, found_depth) = camera.project(camera.ray(pixel[0], pixel[1]).at(depth)).unwrap();
            prop_assert!(found_depth > 0.0 && found_depth <= depth * (1.0 + 1e-12));
            // Positions of about 10 less positions of about 10, at a tenth of a unit, and times the focal length:
            // ε · 100 · 2000 is 4e-11.
            for i in 0..2 {
                prop_assert!((found[i] - pixel[i]).abs() < 1e-9, "{:?} for {:?}", found, pixel);
            }
        }
    }

    const PIXELS: [[f64; 2]; 4] = [[0.5, 0.5], [20.0, 15.0], [39.5, 0.5], [3.25, 29.0]];

    #[test]
    fn rays_project_back_to_their_pixel() {
        let pinhole = Camera::look_at(DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let distortion = Distortion { k: [0.0578, -0.0805, 0.0, 0.0], p: [-9.8e-4, 1.6e-4] };
        for (camera, pixel) in
            [pinhole, Camera { distortion, ..pinhole }].into_iter().flat_map(|c| PIXELS.map(|p| (c, p)))
        {
            let ray = camera.ray(pixel[0], pixel[1]);
            let (found, depth) = camera.project(ray.at(2.0)).unwrap();
            assert!(depth > 0.0 && depth <= 2.0);
            for k in 0..2 {
                // Two rotations and a division in f64 on numbers below 100, whose ulp is 1.4e-14: the bound
                // is 7000 ulps.
                assert!((found[k] - pixel[k]).abs() < 1e-12 * 100.0, "{found:?} for {pixel:?}");
            }
        }
        assert!(pinhole.project(pinhole.position + pinhole.axes.z_axis).is_none());
    }

    #[test]
    fn cameras_are_alike_if_images_are() {
        let camera = Camera::look_at(DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let pixel = 1.0 / camera.focal[0];
        let moved = |by: f64| Camera { position: camera.position + by * DVec3::X, ..camera };
        let turned = |by: f64| Camera { axes: camera.axes * DMat3::from_rotation_y(by), ..camera };
        // Poses with four digits, as in files, and another number of pixels are still alike.
        assert!(camera.is_like(&moved(1e-4), 2.0) && camera.is_like(&camera.resized([400, 300]), 2.0));
        assert!(camera.is_like(&moved(0.49 * pixel), 2.0) && !camera.is_like(&moved(0.51 * pixel), 2.0));
        assert!(camera.is_like(&turned(0.24 * pixel), 2.0) && !camera.is_like(&turned(0.26 * pixel), 2.0));
        let other = Distortion { k: [0.2, 0.0, 0.0, 0.0], p: [0.0; 2] };
        assert!(!camera.is_like(&Camera { distortion: other, ..camera }, 2.0));
        assert!(!camera.is_like(&Camera { focal: [1.05 * camera.focal[0]; 2], ..camera }, 2.0));
    }

    #[test]
    fn every_number_is_in_the_checksum() {
        let camera = Camera::look_at(DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let next = |v: &mut f64| *v = v.next_up();
        let changes: [&dyn Fn(&mut Camera); 10] = [
            &|c| next(&mut c.position.y),
            &|c| next(&mut c.axes.z_axis.x),
            &|c| next(&mut c.focal[1]),
            &|c| next(&mut c.center[0]),
            &|c| next(&mut c.distortion.k[1]),
            &|c| next(&mut c.distortion.k[2]),
            &|c| next(&mut c.distortion.k[3]),
            &|c| next(&mut c.distortion.p[0]),
            &|c| c.resolution[0] += 1,
            &|c| c.resolution[1] += 1,
        ];
        let mut sums: Vec<u32> = changes
            .iter()
            .map(|change| {
                let mut other = camera;
                change(&mut other);
                Camera::checksum(&[other])
            })
            .chain([Camera::checksum(&[camera]), Camera::checksum(&[camera; 2]), Camera::checksum(&[])])
            .collect();
        sums.sort_unstable();
        sums.dedup();
        assert_eq!(sums.len(), changes.len() + 3);
    }

    #[test]
    fn lenses_that_fold_the_image_over_are_told() {
        let camera = Camera::look_at(DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z, 0.9, [40, 30]);
        let with = |[k1, k2]: [f64; 2], p: [f64; 2]| {
            Camera { distortion: Distortion { k: [k1, k2, 0.0, 0.0], p }, ..camera }.folds_over()
        };
        // Real lenses: of an action camera, of a phone, and a barrel as strong as they get at this angle.
        for (k, p) in [([-0.27, 0.09], [1e-3, -5e-4]), ([0.06, -0.08], [-1e-3, 2e-4]), ([-0.4, 0.2], [0.0; 2])] {
            assert_eq!(with(k, p), None, "{k:?}, {p:?}");
        }
        // r (1 - 5 r²) is at most 0.172 (at r = 0.258), so that pixels farther from the centre have no ray: those
        // outside of a circle of 0.172 in an image of 0.966 × 0.724 half of its width, 0.483 and 0.362.
        let share = 1.0 - std::f64::consts::PI * 0.172_f64.powi(2) / (4.0 * 0.483 * 0.362);
        let said = with([-5.0, 0.0], [0.0; 2]).unwrap();
        let percent: f64 = said.split(" for ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((percent - 100.0 * share).abs() < 4.0, "{said}, expected {share}");
        for (k, p) in [([1e300, 0.0], [0.0; 2]), ([0.0, -1e6], [0.0; 2]), ([0.0; 2], [50.0, 0.0])] {
            assert!(with(k, p).is_some(), "{k:?}, {p:?}");
        }
    }

    #[test]
    fn up_is_up_and_rows_grow_downwards() {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, [40, 40]);
        assert!(camera.ray(20.0, 0.0).direction.z > 0.0, "the top row looks up");
        assert!(camera.ray(40.0, 20.0).direction.x > 0.0, "the right column looks right");
    }

    #[test]
    fn what_a_lens_folds_back_into_the_image_is_outside() {
        let pinhole = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 1.2, [80, 60]);
        // r (1 - 0.3 r²) rises up to r = 1.05, and comes back to 0 at 1.83.
        let distortion = Distortion { k: [-0.3, 0.0, 0.0, 0.0], ..Distortion::default() };
        let camera = Camera { distortion, ..pinhole };
        let at = |r: f64| DVec3::new(1.0, r, 0.0);
        for (r, is_inside) in [(0.0, true), (0.4, true), (0.8, true), (1.5, false), (1.8, false), (2.5, false)] {
            assert_eq!(camera.project_inside(at(r)).is_some(), is_inside, "{r}");
        }
        assert!([1.5, 1.8].iter().all(|&r| camera.project(at(r)).is_some_and(|([x, _], _)| (0.0..80.0).contains(&x))));
        assert_eq!(camera.project_inside(at(0.4)), camera.project(at(0.4)));
    }
}
