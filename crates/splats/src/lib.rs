//! Gaussian splats: a scene as many small ellipsoids, each with an opacity and a colour that depends on the direction
//! (Kerbl, Kopanas, Leimkühler, Drettakis, "3D Gaussian Splatting", 2023).
//!
//! [`Splats`] has the parameters as training leaves them: logarithms of scales, logits of opacities, coefficients of
//! spherical harmonics. [`Splats::read`] takes them from files, [`Splats::write`] writes them back, in
//! any of the formats. [`SplatRenderer`] draws the images of the original code, and differentiates them with respect
//! to where splats are; with it splats are a [`Model`](octobayes::estimate::Model) like any other.
//!
//! # Example
//! ```
//! use glam::{DVec3, Quat, Vec3};
//! use octobayes::estimate::{Estimation, GridSettings, RaySettings};
//! use octobayes::geometry::{Aabb, Camera, Domain};
//! use octobayes_splats::{RenderMode, Splats};
//!
//! // One opaque grey ball, seen from the side x > 0.
//! let (mean, log_scale, logit) = (Vec3::ZERO, Vec3::splat(-2.0), 6.0);
//! let splats = Splats::new(
//!     vec![mean], vec![log_scale], vec![Quat::IDENTITY], vec![logit], vec![0.3; 3], 0, RenderMode::Classic,
//! )?;
//! let cameras = [Camera::look_at(DVec3::X * 3.0, DVec3::ZERO, DVec3::Z, 0.6, [32, 32])];
//! let run = Estimation::new(&splats, &cameras).domain(Domain::Box(Aabb::centered_cube(1.0)));
//! let field = run.rays(RaySettings::default().rays(1000)).grid(GridSettings::default().level(4)).run()?.field;
//! // It could move along the view, and hardly across it; where nothing is, anything could.
//! assert!(field.query(mean).uncertainty < field.query(Vec3::splat(-0.8)).uncertainty);
//! # Ok::<(), octobayes::Error>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod columns;
mod files;
mod mode;
mod model;
mod render;
mod seen;
mod summary;

use glam::{Quat, Vec3};
use octobayes::geometry::Aabb;
use octobayes::{Error, Result};

use self::columns::Layout;
pub use self::mode::RenderMode;
pub use self::render::{SeenSpace, SplatRenderer, seen_domain, tile_of};
pub use self::seen::SeenSplats;
// What only our own crates name.
#[doc(hidden)]
pub use self::{
    files::refuse_checkpoint,
    render::{
        FAINTEST, FRUSTUM_MARGIN, Footprint, Hit, Hits, MIN_TRANSMITTANCE, MOST_OPAQUE, NEAR, Projector, Shape,
        SplatView, boxed, middle,
    },
    seen::{stride_for, strided_pixels},
    summary::{QUANTILES, Summary},
};
// Tests of other crates compare with the slow reference.
#[doc(hidden)]
pub use render::reference;

/// Highest degree of spherical harmonics that files have.
pub const MAX_DEGREE: u8 = 3;

/// Largest difference of a rotation's squared length from 1 that [`Splats::new`] accepts.
const UNIT: f32 = 1e-4;

/// A scene of n Gaussian splats. All numbers are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Splats {
    means: Vec<Vec3>,
    log_scales: Vec<Vec3>,
    rotations: Vec<Quat>,
    opacity_logits: Vec<f32>,
    sh: Vec<f32>,
    degree: u8,
    mode: RenderMode,
    /// What the file had beside the parameters.
    layout: Layout,
    notes: Vec<String>,
}

impl Splats {
    /// Splats from their parameters.
    ///
    /// - `means` `[n]`: centres, scene units.
    /// - `log_scales` `[n]`: natural logarithms of the standard deviations along a splat's own axes.
    /// - `rotations` `[n]`: unit quaternions, from a splat's axes to the scene's.
    /// - `opacity_logits` `[n]`: ln(o / (1 − o)) of the opacity o at the centre.
    /// - `sh` `[n, (degree + 1)², 3]`: coefficients of red, green and blue, in the order and with the signs of the
    ///   original code. The colour is ½ plus their sum, and not below 0.
    ///
    /// # Errors
    /// If there are no splats, if an array has another length, if a number is not finite, if a rotation's length is not
    /// 1, or if the degree is above [`MAX_DEGREE`].
    pub fn new(
        means: Vec<Vec3>,
        log_scales: Vec<Vec3>,
        rotations: Vec<Quat>,
        opacity_logits: Vec<f32>,
        sh: Vec<f32>,
        degree: u8,
        mode: RenderMode,
    ) -> Result<Self> {
        let n = means.len();
        if n == 0 {
            return Err(Error::setting("splats", "at least one", "0"));
        }
        if degree > MAX_DEGREE {
            let expected = format!("a degree from 0 to {MAX_DEGREE}");
            return Err(Error::setting("spherical harmonics", expected, degree.to_string()));
        }
        let expected_sh = n * 3 * coefficients(degree);
        for (what, expected, found) in [
            ("log scales", n, log_scales.len()),
            ("rotations", n, rotations.len()),
            ("opacities", n, opacity_logits.len()),
            ("spherical harmonics", expected_sh, sh.len()),
        ] {
            if found != expected {
                let expected = format!("{expected} entries for {n} splats");
                return Err(Error::setting(what, expected, found.to_string()));
            }
        }
        let splats = Self {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            degree,
            mode,
            layout: Layout::original(degree, n),
            notes: Vec::new(),
        };
        for i in 0..n {
            if let Some((what, found)) = splats.first_not_finite(i) {
                return Err(Error::setting(format!("{what} of splat {i}"), "a finite number", found.to_string()));
            }
            let length = splats.rotations[i].length();
            if (length * length - 1.0).abs() > UNIT {
                let what = format!("rotation of splat {i}");
                return Err(Error::setting(what, "a quaternion of length 1", format!("length {length}")));
            }
        }
        Ok(splats)
    }

    /// The first number of splat `i` that is NaN or infinite, and which parameter has it.
    fn first_not_finite(&self, i: usize) -> Option<(&'static str, f32)> {
        let bad = |values: &[f32]| values.iter().copied().find(|v| !v.is_finite());
        let of = |what: &'static str, values: &[f32]| bad(values).map(|found| (what, found));
        of("mean", &self.means[i].to_array())
            .or_else(|| of("log scale", &self.log_scales[i].to_array()))
            .or_else(|| of("rotation", &self.rotations[i].to_array()))
            .or_else(|| of("opacity", &[self.opacity_logits[i]]))
            .or_else(|| of("spherical harmonics", self.sh(i)))
    }

    /// Number of splats, n ≥ 1.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Centres `[n]`, scene units.
    #[must_use]
    pub fn means(&self) -> &[Vec3] {
        &self.means
    }

    /// Centre of splat `i`, scene units.
    #[must_use]
    pub fn mean(&self, i: usize) -> Vec3 {
        self.means[i]
    }

    /// Natural logarithms of the standard deviations along each splat's own axes, `[n]`.
    #[must_use]
    pub fn log_scales(&self) -> &[Vec3] {
        &self.log_scales
    }

    /// Standard deviations of splat `i` along its own axes, scene units.
    #[must_use]
    pub fn scale(&self, i: usize) -> Vec3 {
        self.log_scales[i].map(f32::exp)
    }

    /// Rotation of splat `i`, from its axes to the scene's; of length 1.
    #[must_use]
    pub fn rotation(&self, i: usize) -> Quat {
        self.rotations[i]
    }

    /// Logits of the opacities, `[n]`.
    #[must_use]
    pub fn opacity_logits(&self) -> &[f32] {
        &self.opacity_logits
    }

    /// Opacity of splat `i` at its centre, in [0, 1].
    #[must_use]
    pub fn opacity(&self, i: usize) -> f32 {
        1.0 / (1.0 + (-self.opacity_logits[i]).exp())
    }

    /// Spherical harmonics of splat `i`, `[(degree + 1)², 3]`: red, green and blue of each coefficient.
    #[must_use]
    pub fn sh(&self, i: usize) -> &[f32] {
        let count = 3 * coefficients(self.degree);
        &self.sh[i * count..(i + 1) * count]
    }

    /// Colour of splat `i` by the constant of its spherical harmonics alone, 0 or more: the mean over all directions,
    /// if no direction's colour is cut off.
    #[must_use]
    pub fn constant_color(&self, i: usize) -> Vec3 {
        render::color(&self.sh(i)[..3], glam::DVec3::Z).as_vec3()
    }

    /// Degree of the spherical harmonics, 0 to [`MAX_DEGREE`].
    #[must_use]
    pub fn degree(&self) -> u8 {
        self.degree
    }

    /// How small splats are drawn.
    #[must_use]
    pub fn mode(&self) -> RenderMode {
        self.mode
    }

    /// The box of all centres, which is not flat: at least a millionth of its longest edge wide.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        let [low, high] =
            [Vec3::min, Vec3::max].map(|of| self.means.iter().copied().fold(self.means[0], of).as_dvec3());
        let middle = 0.5 * (low + high);
        let longest =
            (high - low).max_element().max(1e-6 * middle.abs().max_element()).max(f64::from(f32::MIN_POSITIVE));
        let half = (0.5 * (high - low)).max(glam::DVec3::splat(0.5e-6 * longest));
        Aabb::new(middle - half, middle + half).expect("means are finite, and the box is not flat")
    }

    /// One human-readable line: number, colours and mode.
    #[must_use]
    pub fn describe(&self) -> String {
        format!("{} splats, spherical harmonics of degree {}, {}", self.len(), self.degree, self.mode)
    }

    /// The same splats, drawn in another mode.
    #[must_use]
    pub fn with_mode(self, mode: RenderMode) -> Self {
        Self { mode, ..self }
    }

    /// The same splats in colours, `[n]`, that do not depend on the direction; without what else the file had.
    ///
    /// # Panics
    /// If there is not one colour for each splat.
    #[must_use]
    pub fn in_colors(&self, colors: &[Vec3]) -> Self {
        assert_eq!(colors.len(), self.len(), "colours of {} splats", self.len());
        let sh = colors.iter().flat_map(|color| color.to_array().map(|v| files::constant_of(v.into()))).collect();
        let (layout, notes) = (Layout::original(0, self.len()), Vec::new());
        Self { sh, degree: 0, layout, notes, ..self.clone() }
    }

    /// What a user should know of the file, a sentence each: splats that were dropped, numbers that were replaced.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Comments of the file's header.
    #[must_use]
    pub fn comments(&self) -> &[String] {
        &self.layout.comments
    }

    /// Names of the file's properties that have no meaning here, in their order.
    #[must_use]
    pub fn extra_names(&self) -> Vec<&str> {
        self.layout.extras.iter().map(|extra| extra.name.as_str()).collect()
    }

    /// The numbers `[n]` of a property that has no meaning here.
    #[must_use]
    pub fn extra(&self, name: &str) -> Option<Vec<f64>> {
        let extra = self.layout.extras.iter().find(|extra| extra.name == name)?;
        Some((0..self.len()).map(|i| extra.number(i)).collect())
    }

    /// Size in memory, bytes.
    #[must_use]
    pub fn memory(&self) -> usize {
        let vectors =
            size_of_val(&self.means[..]) + size_of_val(&self.log_scales[..]) + size_of_val(&self.rotations[..]);
        let numbers = size_of_val(&self.opacity_logits[..]) + size_of_val(&self.sh[..]);
        let numbers = numbers + self.layout.extras.iter().map(|extra| extra.bytes.len()).sum::<usize>();
        vectors + numbers
    }

    /// The splats for which `kept` (`[n]`) is true, in their order, with all that the file had for them.
    ///
    /// # Errors
    /// If `kept` has another length, or if none is kept.
    pub fn keep(mut self, kept: &[bool]) -> Result<Self> {
        let n = self.len();
        if kept.len() != n {
            return Err(Error::setting("splats to keep", format!("{n} entries"), kept.len().to_string()));
        }
        if !kept.contains(&true) {
            return Err(Error::setting("splats to keep", "at least one", format!("none of {n}")));
        }
        retain(&mut self.means, kept, 1);
        retain(&mut self.log_scales, kept, 1);
        retain(&mut self.rotations, kept, 1);
        retain(&mut self.opacity_logits, kept, 1);
        retain(&mut self.sh, kept, 3 * coefficients(self.degree));
        self.layout.extras.iter_mut().for_each(|extra| extra.keep(kept));
        Ok(self)
    }

    /// The same splats with what the file of `other` had beside the parameters.
    ///
    /// # Panics
    /// If `other` has another number of splats, or another degree.
    #[must_use]
    pub fn with_layout_of(self, other: &Self) -> Self {
        assert_eq!((self.len(), self.degree), (other.len(), other.degree), "splats and degree of a layout");
        Self { layout: other.layout.clone(), ..self }
    }

    fn with_comments(mut self, comments: Vec<String>) -> Self {
        self.layout.comments = comments;
        self
    }
}

/// Keeps the groups of `width` values for which `kept` is true.
fn retain<T>(values: &mut Vec<T>, kept: &[bool], width: usize) {
    let mut index = 0..values.len();
    values.retain(|_| index.next().is_some_and(|i| kept[i / width]));
}

/// Number of coefficients of a colour channel.
const fn coefficients(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The arguments of [`Splats::new`] for two splats.
    struct Two {
        means: Vec<Vec3>,
        rotations: Vec<Quat>,
        sh: Vec<f32>,
        degree: u8,
    }

    fn two(change: impl FnOnce(&mut Two)) -> Result<Splats> {
        let (means, rotations) = (vec![Vec3::ZERO, Vec3::X], vec![Quat::IDENTITY; 2]);
        let mut two = Two { means, rotations, sh: vec![0.5; 2 * 4 * 3], degree: 1 };
        change(&mut two);
        let scales = vec![Vec3::new(0.0, -1.0, 1.0); 2];
        let Two { means, rotations, sh, degree } = two;
        Splats::new(means, scales, rotations, vec![0.0, 3.0], sh, degree, RenderMode::Classic)
    }

    #[test]
    fn parameters_are_read_as_they_act() {
        let splats = two(|two| two.sh[12] = 7.0).unwrap();
        assert_eq!((splats.len(), splats.degree(), splats.mode()), (2, 1, RenderMode::Classic));
        assert_eq!(splats.scale(1), Vec3::new(1.0, (-1.0_f32).exp(), 1.0_f32.exp()));
        assert_eq!(splats.opacity(0), 0.5);
        assert!((splats.opacity(1) - 0.952_574_1).abs() < 1e-6, "{}", splats.opacity(1));
        assert_eq!((splats.sh(0)[0], splats.sh(1)[0], splats.sh(1).len()), (0.5, 7.0, 12));
        assert_eq!(splats.with_mode(RenderMode::Mip).mode(), RenderMode::Mip);
    }

    #[test]
    fn a_part_of_the_splats_is_kept() {
        let splats = two(|two| two.sh[12..].fill(0.25)).unwrap();
        let second = splats.clone().keep(&[false, true]).unwrap();
        assert_eq!((second.len(), second.mean(0), second.opacity_logits()[0]), (1, Vec3::X, 3.0));
        assert_eq!((second.sh(0), second.extra("nx")), (&[0.25; 12][..], Some(vec![0.0])));
        assert_eq!(splats.clone().keep(&[true; 2]).unwrap(), splats);
        let error = |kept: &[bool]| splats.clone().keep(kept).unwrap_err().to_string();
        assert_eq!(error(&[true]), "splats to keep: expected 2 entries, found 1");
        assert_eq!(error(&[false; 2]), "splats to keep: expected at least one, found none of 2");
    }

    #[test]
    fn what_is_no_splat_is_refused_with_its_index() {
        let refused = |change: fn(&mut Two), expected: &str| {
            assert_eq!(two(change).unwrap_err().to_string(), expected);
        };
        refused(|two| two.means.clear(), "splats: expected at least one, found 0");
        refused(|two| two.means[1].y = f32::NAN, "mean of splat 1: expected a finite number, found NaN");
        refused(|two| two.sh[3] = f32::INFINITY, "spherical harmonics of splat 0: expected a finite number, found inf");
        refused(
            |two| two.rotations[1] = Quat::from_xyzw(0.0, 0.0, 0.0, 2.0),
            "rotation of splat 1: expected a quaternion of length 1, found length 2",
        );
        refused(|two| two.sh.truncate(23), "spherical harmonics: expected 24 entries for 2 splats, found 23");
        refused(|two| two.degree = 4, "spherical harmonics: expected a degree from 0 to 3, found 4");
        refused(|two| two.rotations.truncate(1), "rotations: expected 2 entries for 2 splats, found 1");
    }
}
