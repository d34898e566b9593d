//! What is summed at a vertex: all of S, or only its diagonal, off which most deviations are read.

use std::fmt::Debug;
use std::ops::AddAssign;

use bytemuck::{Pod, Zeroable};

use crate::io::container::Item;

/// S = Σ_r JᵀJ of one vertex, summed over rays and colour channels: xx, xy, xz, yy, yz, zz, in 1 / scene unit².
pub type Information = [f64; 6];

/// tr S.
#[must_use]
pub fn trace(s: &Information) -> f64 {
    s[0] + s[3] + s[5]
}

/// Dot product of two columns of a 3×3 Jacobian given row by row. A function rather than a closure, because only a
/// function can be marked for inlining, which compiles it for AVX where J is squared.
#[inline(always)]
fn dot(j: &[f64; 9], a: usize, b: usize) -> f64 {
    j[a] * j[b] + j[3 + a] * j[3 + b] + j[6 + a] * j[6 + b]
}

/// The entries of S that are summed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entries {
    /// All six, in [`VertexSums`].
    All,
    /// xx, yy and zz, in [`DiagonalSums`]: bit for bit the same sums, in little more than half of the memory.
    Diagonal,
}

impl Entries {
    /// Bytes of these sums in a file.
    #[must_use]
    pub fn record_bytes(self) -> usize {
        match self {
            Self::All => VertexSums::SIZE,
            Self::Diagonal => DiagonalSums::SIZE,
        }
    }
}

/// The sums that an octree has at each vertex.
pub trait Sums: Item + Pod + Default + PartialEq + Debug + Send + Sync + for<'a> AddAssign<&'a Self> {
    /// The name of what is summed.
    const NAME: &'static str;
    /// Whether all of S is there.
    const IS_WHOLE: bool;
    /// What a ray adds: entries of JᵀJ.
    type Square: Copy + Debug + Send + Sync;

    /// JᵀJ of the J of a vertex, given row by row, colour × axis.
    fn square(jacobian: &[f64; 9]) -> Self::Square;

    /// The sums over one ray.
    fn of_ray(square: Self::Square) -> Self;

    /// Number of rays.
    fn rays(&self) -> u32;

    /// tr S.
    fn trace(&self) -> f64;

    /// All of S, with zeros for what is not summed.
    fn widened(&self) -> VertexSums;

    /// What is summed here of all of S.
    fn narrowed(sums: &VertexSums) -> Self;
}

/// Sums over the rays that touched a vertex; 56 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct VertexSums {
    /// S.
    pub information: Information,
    /// Number of rays with a sample in one of the vertex's cells.
    pub rays: u32,
    /// Fills the last bytes, so that sums can lie in memory that is mapped.
    unused: u32,
}

impl VertexSums {
    /// Sums over so many rays.
    #[must_use]
    #[inline]
    pub fn new(information: Information, rays: u32) -> Self {
        Self { information, rays, unused: 0 }
    }

    /// Checks whether rays can have produced these sums.
    ///
    /// All numbers are finite, the diagonal of the information is not negative, and its other entries are not
    /// larger than a sum of squares allows (Cauchy-Schwarz).
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let [xx, xy, xz, yy, yz, zz] = self.information;
        // Each of at most 2³² terms is rounded by 2⁻⁵³ of its bound. Subnormal numbers have no bounded relative
        // rounding.
        let bounded = |product: f64, a: f64, b: f64| {
            product.abs() <= a.sqrt() * b.sqrt() * (1.0 + 1e-6) + f64::MIN_POSITIVE.sqrt()
        };
        trace(&self.information).is_finite()
            && xx.min(yy).min(zz) >= 0.0
            && bounded(xy, xx, yy)
            && bounded(xz, xx, zz)
            && bounded(yz, yy, zz)
    }
}

impl AddAssign<&Self> for VertexSums {
    /// Adds the sums over other rays.
    #[inline]
    fn add_assign(&mut self, other: &Self) {
        self.information.iter_mut().zip(other.information).for_each(|(s, o)| *s += o);
        self.rays = self.rays.saturating_add(other.rays);
    }
}

impl Item for VertexSums {
    const SIZE: usize = Information::SIZE + u32::SIZE;

    fn put(self, out: &mut Vec<u8>) {
        self.information.put(out);
        self.rays.put(out);
    }

    fn take(bytes: &[u8]) -> Self {
        let (information, rays) = bytes.split_at(Information::SIZE);
        Self::new(Item::take(information), Item::take(rays))
    }
}

impl Sums for VertexSums {
    const NAME: &'static str = "all of S";
    const IS_WHOLE: bool = true;
    type Square = Information;

    #[inline(always)]
    fn square(j: &[f64; 9]) -> Information {
        [dot(j, 0, 0), dot(j, 0, 1), dot(j, 0, 2), dot(j, 1, 1), dot(j, 1, 2), dot(j, 2, 2)]
    }

    #[inline(always)]
    fn of_ray(square: Information) -> Self {
        Self::new(square, 1)
    }

    #[inline(always)]
    fn rays(&self) -> u32 {
        self.rays
    }

    fn trace(&self) -> f64 {
        trace(&self.information)
    }

    fn widened(&self) -> VertexSums {
        *self
    }

    fn narrowed(sums: &VertexSums) -> Self {
        *sums
    }
}

/// The diagonal of a vertex's sums; 32 bytes, which never lie in two lines of a cache.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct DiagonalSums {
    /// xx, yy and zz of S.
    diagonal: [f64; 3],
    rays: u32,
    unused: u32,
}

impl AddAssign<&Self> for DiagonalSums {
    /// Adds the sums over other rays.
    #[inline]
    fn add_assign(&mut self, other: &Self) {
        self.diagonal.iter_mut().zip(other.diagonal).for_each(|(s, o)| *s += o);
        self.rays = self.rays.saturating_add(other.rays);
    }
}

impl Item for DiagonalSums {
    const SIZE: usize = <[f64; 3]>::SIZE + u32::SIZE;

    fn put(self, out: &mut Vec<u8>) {
        self.diagonal.put(out);
        self.rays.put(out);
    }

    fn take(bytes: &[u8]) -> Self {
        let (diagonal, rays) = bytes.split_at(<[f64; 3]>::SIZE);
        Self { diagonal: Item::take(diagonal), rays: Item::take(rays), unused: 0 }
    }
}

impl Sums for DiagonalSums {
    const NAME: &'static str = "the diagonal of S";
    const IS_WHOLE: bool = false;
    type Square = [f64; 3];

    #[inline(always)]
    fn square(j: &[f64; 9]) -> [f64; 3] {
        [dot(j, 0, 0), dot(j, 1, 1), dot(j, 2, 2)]
    }

    #[inline(always)]
    fn of_ray(diagonal: [f64; 3]) -> Self {
        Self { diagonal, rays: 1, unused: 0 }
    }

    #[inline(always)]
    fn rays(&self) -> u32 {
        self.rays
    }

    fn trace(&self) -> f64 {
        let [xx, yy, zz] = self.diagonal;
        xx + yy + zz
    }

    fn widened(&self) -> VertexSums {
        let [xx, yy, zz] = self.diagonal;
        VertexSums::new([xx, 0.0, 0.0, yy, 0.0, zz], self.rays)
    }

    fn narrowed(sums: &VertexSums) -> Self {
        let [xx, _, _, yy, _, zz] = sums.information;
        Self { diagonal: [xx, yy, zz], rays: sums.rays, unused: 0 }
    }
}
