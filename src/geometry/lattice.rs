//! The finest lattice, in the unit cube to which Φ maps scene coordinates.
//!
//! It has `M` = 2^level cells and M + 1 points per axis. Point (i, j, k) sits at Φ⁻¹((i, j, k) / M). Cells
//! are half-open, `[lo, hi)`; the upper faces of the cube belong to the last cells.

use glam::{DVec3, Vec3};

use super::{Aabb, Domain};
use crate::{Error, Result};

/// Largest supported level: lattice coordinates then need 17 bits per axis, 51 in a Morton code.
pub const MAX_LEVEL: u8 = 16;

/// The finest lattice {0..M}³ of a domain.
///
/// ```
/// use octobayes::geometry::{Aabb, Lattice};
///
/// let lattice = Lattice::new(Aabb::centered_cube(1.0), 8)?;
/// assert_eq!(lattice.cells_per_axis(), 256);
/// // A point counts along every axis, on both faces of the box.
/// assert_eq!(lattice.dense_vertices(), 257 * 257 * 257);
/// assert_eq!(lattice.edge().x, 2.0 / 256.0);
/// # Ok::<(), octobayes::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Lattice {
    domain: Domain,
    level: u8,
}

impl Lattice {
    /// The lattice with 2^`level` cells along every axis of `bounds`.
    ///
    /// # Errors
    /// If `level` is 0 or above [`MAX_LEVEL`].
    pub fn new(bounds: Aabb, level: u8) -> Result<Self> {
        Self::from_domain(Domain::Box(bounds), level)
    }

    /// The lattice with 2^`level` cells along every axis of the unit cube to which `domain` is mapped.
    ///
    /// # Errors
    /// If `level` is 0 or above [`MAX_LEVEL`].
    pub fn from_domain(domain: Domain, level: u8) -> Result<Self> {
        if (1..=MAX_LEVEL).contains(&level) {
            Ok(Self { domain, level })
        } else {
            Err(Error::setting("level", format!("1 to {MAX_LEVEL}"), level.to_string()))
        }
    }

    /// The lattice of the same domain with 2^`level` cells per axis, if that is coarser.
    #[must_use]
    pub fn coarsened(&self, level: u8) -> Self {
        Self { level: level.clamp(1, self.level), ..*self }
    }

    /// The part of space that the lattice spans.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// log2 of [`Lattice::cells_per_axis`].
    #[must_use]
    pub fn level(&self) -> u8 {
        self.level
    }

    /// M: cells per axis.
    #[must_use]
    pub fn cells_per_axis(&self) -> u32 {
        1 << self.level
    }

    /// Number of points of the dense grid, (M + 1)³.
    #[must_use]
    pub fn dense_vertices(&self) -> u64 {
        let n = u64::from(self.cells_per_axis()) + 1;
        n * n * n
    }

    /// Position of a lattice point in the arrays of a dense grid: x slowest, z fastest.
    ///
    /// A grid has one point more than cells along each axis: a stride of M instead of M + 1 would let opposite faces
    /// share entries.
    #[must_use]
    pub fn dense_index(&self, point: [u32; 3]) -> usize {
        let n = self.cells_per_axis() as usize + 1;
        point.into_iter().fold(0, |index, i| index * n + i as usize)
    }

    /// The lattice point at a position in the arrays of a dense grid.
    #[must_use]
    pub fn dense_point(&self, index: usize) -> [u32; 3] {
        let n = self.cells_per_axis() as usize + 1;
        [index / (n * n), index / n % n, index % n].map(|i| i as u32)
    }

    /// Edge lengths of a finest cell in scene units, where space is not contracted.
    #[must_use]
    pub fn edge(&self) -> DVec3 {
        self.domain.size() / f64::from(self.cells_per_axis())
    }

    /// Lattice coordinates of a scene point, in `[0, M]` per axis; `None` outside the domain or if x is not finite.
    #[must_use]
    #[inline]
    pub fn coordinates(&self, x: Vec3) -> Option<DVec3> {
        self.domain.to_unit(x).map(|u| u * f64::from(self.cells_per_axis()))
    }

    /// Scene position of lattice coordinates.
    #[must_use]
    pub fn position(&self, u: DVec3) -> DVec3 {
        self.domain.to_scene(u / f64::from(self.cells_per_axis()))
    }

    /// The finest cell that contains lattice coordinates `u` in `[0, M]`³, and the offset inside it in `[0, 1]`³.
    ///
    /// An offset reaches 1 only on the upper faces of the cube.
    #[must_use]
    #[inline]
    pub fn cell(&self, u: DVec3) -> ([u32; 3], DVec3) {
        let last = self.cells_per_axis() - 1;
        let mut cell = [0; 3];
        let mut offset = DVec3::ZERO;
        for axis in 0..3 {
            // A float-to-integer cast truncates and saturates, so rounding never leaves the lattice.
            cell[axis] = (u[axis] as u32).min(last);
            offset[axis] = u[axis] - f64::from(cell[axis]);
        }
        (cell, offset)
    }

    /// The paper's prior precision λ, 1e-4 / M³ per squared longest edge of the domain ([`Domain::size`]), in
    /// 1 / scene unit².
    ///
    /// The official code uses 1e-4 / M³ in its own world units. Tying the unit to the domain makes U scale
    /// with the scene.
    #[must_use]
    pub fn default_lambda(&self) -> f64 {
        let m = f64::from(self.cells_per_axis());
        1e-4 / (m * m * m) / self.domain.size().max_element().powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_face_belongs_to_the_last_cell() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 3).unwrap();
        let u = lattice.coordinates(Vec3::new(1.0, -1.0, 0.0)).unwrap();
        let (cell, offset) = lattice.cell(u);
        assert_eq!(cell, [7, 0, 4]);
        assert_eq!(offset, DVec3::new(1.0, 0.0, 0.0));
    }

    #[test]
    fn outside_and_nan_have_no_coordinates() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 3).unwrap();
        assert!(lattice.coordinates(Vec3::new(1.000_001, 0.0, 0.0)).is_none());
        assert!(lattice.coordinates(Vec3::new(f32::NAN, 0.0, 0.0)).is_none());
    }

    #[test]
    fn levels_outside_the_range_are_refused() {
        for level in [0, 17, 255] {
            assert!(Lattice::new(Aabb::centered_cube(1.0), level).is_err());
        }
    }

    #[test]
    fn the_paper_prior_shows_as_5_70() {
        // M = 256, as in the paper: log10 U = ½ log10(3 / 2λ) ≈ 5.70 where nothing was seen, for a box of edge 1.
        let lattice = Lattice::new(Aabb::centered_cube(0.5), 8).unwrap();
        let log10_u = 0.5 * (3.0 / (2.0 * lattice.default_lambda())).log10();
        assert!((log10_u - 5.70).abs() < 0.005, "{log10_u}");
    }

    #[test]
    fn dense_positions_are_those_of_an_array_whose_last_axis_runs_fastest() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 2).unwrap();
        let points = (0..5).flat_map(|x| (0..5).flat_map(move |y| (0..5).map(move |z| [x, y, z])));
        for (index, point) in points.enumerate() {
            assert_eq!((lattice.dense_index(point), lattice.dense_point(index)), (index, point));
        }
        assert_eq!(lattice.dense_vertices(), 125);
    }
}
