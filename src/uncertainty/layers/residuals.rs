//! Photometric residuals of the training images, on the vertices of a lattice.
//!
//! The Laplace approximation measures how far matter could be moved before a training image changed. It does not
//! include errors that no displacement explains: noise of the images, and content that the model cannot represent
//! (Goli et al. 2024, section 6, "aleatoric"). So a deviation of depth adds them: σ² = Var + s² + (c m)².
//!
//! Letters: r² squared residual of a pixel's colour, mean over red, green and blue; φ trilinear weights; m root mean
//! square residual around a point; c a length.

use glam::Vec3;
use rustc_hash::FxHashMap;

use serde_json::{Value, json};

use super::super::file::Source;
use super::point_means::{self, PointMeans};
use super::{Change, Layer, Merge, Sections};
use crate::geometry::Lattice;
use crate::octree::corners;
use crate::posterior::{DataScale, Scale};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The weight of the mean over all pixels at every vertex, in pixels.
const PRIOR: f64 = 1.0;

/// Residuals of the training images around each point.
#[derive(Debug, Clone, PartialEq)]
pub struct Residuals {
    /// c as a share of the longest edge.
    length_share: f64,
    /// Mean r² over the pixels of all images that show matter; around a vertex, drawn towards the mean of all as if one
    /// more pixel had it.
    squares: PointMeans,
}

impl Residuals {
    /// Finest level of the lattice: its cells should hold many pixels.
    pub const LEVEL: u8 = 6;

    /// c as a share of the longest edge of the part of space that is not contracted: an image that is off by a tenth of
    /// its range leaves depth uncertain by a 100th of the edge. One constant for all scenes, chosen by likelihood
    /// (`experiments/depth.md`): with a 20th, the intervals of well-trained models and of few views are narrower than
    /// they should be; with 3/20, likelihood falls on all meshes.
    ///
    /// A field that was written with another share keeps that.
    pub const LENGTH_SHARE: f64 = 1.0 / 10.0;

    /// Level of the lattice.
    #[must_use]
    pub fn level(&self) -> u8 {
        self.squares.lattice().level()
    }

    /// Root mean square residual over the pixels of all images that show matter, in colours from 0 to 1.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.squares.mean().sqrt()
    }

    /// m, the root mean square residual around a scene point, in colours from 0 to 1. Where no training image shows
    /// matter it is that of all pixels.
    #[must_use]
    pub fn at(&self, x: Vec3) -> f64 {
        let mean = self.squares.mean();
        let around = self.squares.around(x).map(|(square, share)| share * square.unwrap_or(mean));
        around.reduce(|sum, next| sum + next).unwrap_or(mean).sqrt()
    }

    /// c, scene units.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length_share * DataScale::longest_edge(self.squares.lattice().domain())
    }

    /// c m: the deviation of the depth of matter at a scene point that residuals there stand for, scene units.
    #[must_use]
    pub fn depth_deviation(&self, x: Vec3) -> f64 {
        self.length() * self.at(x)
    }

    fn heading(&self) -> Head {
        Head { squares: self.squares.head(), length_share: self.length_share }
    }

    /// Checks the contents of a file; the error names what was expected and found.
    fn checked(
        of_field: &Lattice,
        Head { squares, length_share }: Head,
        contents: (Vec<u64>, Vec<f32>),
    ) -> std::result::Result<Self, (String, String)> {
        // Colours of models may be any numbers.
        let squares = PointMeans::checked(of_field.coarsened(Self::LEVEL), f32::MAX, squares, contents)?;
        if !(0.0..=1.0).contains(&length_share) {
            return Err(("a share of the longest edge, 0 to 1".into(), length_share.to_string()));
        }
        Ok(Self { length_share, squares })
    }
}

/// The residuals' entry in the header of a field's file.
#[derive(Debug, Clone, Copy, serde::Serialize, serde::Deserialize)]
struct Head {
    #[serde(flatten)]
    squares: point_means::Head,
    length_share: f64,
}

impl Layer for Residuals {
    const NAME: &'static str = "residuals";
    /// Only in the scale of the data do depths have deviations.
    const DEPENDS_ON: &'static [Change] = &[Change::Prior];
    /// It depends on the model and not on the rays, so that of one part is enough.
    const MERGE: Merge<Self> = Some(|sum, part| sum.or_else(|| part.cloned()));
    const WITHOUT: &'static str = "what training left unexplained is not known (uncertainty --images)";

    fn head(&self) -> Value {
        json!(self.heading())
    }

    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        let (points, squares) = self.squares.contents();
        vec![("residual points", Box::new(points)), ("residuals", Box::new(squares))]
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Head = file.head(Self::NAME, head)?;
        if file.record.scale == Scale::Paper {
            let expected = "none where depths have no deviations";
            return Err(file.malformed("header, residuals", expected, "one"));
        }
        let sections = (file.section("residual points")?, file.section("residuals")?);
        Self::checked(&file.lattice, head, sections)
            .map_err(|(expected, found)| file.malformed("section `residuals`", expected, found))
    }

    fn memory(&self) -> usize {
        self.squares.memory()
    }

    fn info(&self) -> String {
        format!(
            "where it shows matter, the model is off its training images by {:.4} of their range (root mean square); \
             kept on level {}, counted by deviations of depth",
            self.mean(),
            self.level()
        )
    }
}

/// Sums from which a [`Residuals`] is made, pixel by pixel. They do not depend on anything but the order of the pixels.
#[derive(Debug)]
pub struct ResidualSums {
    lattice: Lattice,
    /// Σ φ r² and Σ φ over the pixels that show a vertex' surroundings, by lattice point.
    sums: FxHashMap<[u32; 3], [f64; 2]>,
    /// Σ r², and the number of pixels.
    all: [f64; 2],
}

impl ResidualSums {
    /// No pixels yet, on the lattice for fields on this one.
    #[must_use]
    pub fn new(of_field: &Lattice) -> Self {
        let lattice = of_field.coarsened(Residuals::LEVEL);
        Self { lattice, sums: FxHashMap::default(), all: [0.0; 2] }
    }

    /// Counts a pixel that shows matter at a scene point with residual r².
    pub fn add(&mut self, x: Vec3, square: f64) {
        self.all = [self.all[0] + square, self.all[1] + 1.0];
        let Some(u) = self.lattice.coordinates(x) else { return };
        let (cell, offset) = self.lattice.cell(u);
        for (point, share) in corners(cell, offset) {
            let sums = self.sums.entry(point).or_default();
            *sums = [sums[0] + share * square, sums[1] + share];
        }
    }

    /// The residuals from the sums of all pixels.
    #[must_use]
    pub fn finish(self) -> Residuals {
        let mean = self.all[0] / self.all[1].max(1.0);
        let of_vertex = |[sum, weight]: [f64; 2]| (sum + PRIOR * mean) / (weight + PRIOR);
        let squares = self.sums.into_iter().map(|(point, sums)| (point, of_vertex(sums)));
        let squares = PointMeans::new(self.lattice, mean, squares);
        Residuals { length_share: Residuals::LENGTH_SHARE, squares }
    }
}

impl UncertaintyField {
    /// What training left unexplained, if it is known. Deviations of depth then count it.
    #[must_use]
    pub fn residuals(&self) -> Option<&Residuals> {
        self.layers.residuals.as_ref()
    }

    /// The same field with what training left unexplained, without a calibrated interval: that was of other deviations.
    ///
    /// # Errors
    /// If the field is not in the scale of its data, or is on another lattice than that of the residuals.
    pub fn with_residuals(mut self, residuals: Residuals) -> Result<Self> {
        let wrong = |expected: &str, found: &str| Err(Error::setting("residuals", expected, found));
        let Scale::Data(_) = self.record.scale else {
            return wrong("a field in the scale of its data, which has deviations of depth", "the paper's scale");
        };
        if *residuals.squares.lattice() != self.lattice.coarsened(Residuals::LEVEL) {
            return wrong("residuals on the field's lattice", "another");
        }
        self.layers.drop_dependent(Change::Residuals);
        self.layers.residuals = Some(residuals);
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::{Aabb, Domain};

    fn lattice(level: u8) -> Lattice {
        Lattice::from_domain(Domain::Box(Aabb::new(DVec3::splat(-1.5), DVec3::splat(1.5)).unwrap()), level).unwrap()
    }

    /// Two pixels at one place, off by 0.1 and 0.3, and many elsewhere that are right.
    fn residuals(level: u8) -> Residuals {
        let mut sums = ResidualSums::new(&lattice(level));
        // A vertex of all levels: weights are 1 and 0.
        let there = Vec3::ZERO;
        sums.add(there, 0.01);
        sums.add(there, 0.09);
        (0..98).for_each(|_| sums.add(Vec3::splat(0.75), 0.0));
        sums.finish()
    }

    #[test]
    fn residuals_are_means_drawn_towards_the_mean_of_all() {
        for (level, own) in [(4, 4), (6, 6), (9, 6)] {
            let found = residuals(level);
            // Of 100 pixels.
            let mean = 0.1 / 100.0;
            assert_eq!(found.level(), own);
            let close = |found: f64, square: f64| (found / square.sqrt() - 1.0).abs() < 1e-6;
            assert!(close(found.mean(), mean));
            assert!(close(found.at(Vec3::ZERO), (0.1 + mean) / 3.0));
            assert!(close(found.at(Vec3::splat(0.75)), mean / 99.0));
            // Where nothing was shown, and outside the box.
            assert!(close(found.at(Vec3::splat(-1.2)), mean) && close(found.at(Vec3::splat(9.0)), mean));
            // Halfway between two vertices: the mean of the squares.
            let half = Vec3::new(1.5 / f32::from(1_u8 << (own - 1)) / 2.0, 0.0, 0.0);
            assert!(close(found.at(half), 0.5 * ((0.1 + mean) / 3.0 + mean)));
            // The box has an edge of 3.
            let length = 3.0 * Residuals::LENGTH_SHARE;
            assert!((found.depth_deviation(Vec3::ZERO) / found.at(Vec3::ZERO) - length).abs() < 1e-12);
            assert!((found.length() - length).abs() < 1e-15);
        }
        let nothing = ResidualSums::new(&lattice(4)).finish();
        assert_eq!((nothing.mean(), nothing.at(Vec3::ZERO)), (0.0, 0.0));
    }

    #[test]
    fn files_are_not_believed() {
        let found = residuals(9);
        let (points, squares) = found.squares.contents();
        let head = found.heading();
        let read = |head| Residuals::checked(&lattice(9), head, (points.to_vec(), squares.to_vec()));
        assert_eq!(read(head).unwrap(), found);
        // A field keeps the share that it was made with.
        let own = read(Head { length_share: 0.3, ..head }).unwrap();
        assert!((own.length() - 0.9).abs() < 1e-12, "{}", own.length());
        for length_share in [-0.1, 1.0 + f64::EPSILON, 1e300, f64::NAN, f64::INFINITY] {
            let (said, found) = read(Head { length_share, ..head }).unwrap_err();
            assert!(said.contains("a share of the longest edge"), "{said}, found {found}");
        }
    }
}
