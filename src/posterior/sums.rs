//! Sums at one vertex over the rays that touched it.

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
