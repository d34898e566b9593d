//! Pooling: a vertex near few rays borrows from its neighbours.
//!
//! Either by [`Shrinkage`], or below a number of rays that the user requests. Letters of the latter, at vertex v: `N`
//! the lattice points within one lattice edge of v along every axis (27, fewer at the faces of the cube); `t_u` tent
//! weights 1, ½, ¼, ⅛ for points that differ in 0, 1, 2, 3 coordinates, normalised over N; `n` the largest ray count of
//! any moved vertex in N; `m` the requested number of rays. The pooled sums are
//!
//! ```text
//! w Σ_v + (1 − w) Σ_{u ∈ N} t_u Σ_u        w = n³ / (n³ + (m/2)³)
//! ```
//!
//! The weight w of the vertex's own sums rises from 0 to 1 around n = m/2. Rays pass a neighbourhood together.
//! Where the neighbours of v have many rays, v's own sums are reliable, even if small, and are left alone. Where
//! none has many, v's sums are due to chance. Counting only v's own rays, or taking block means until there are
//! enough rays, smears surfaces into the adjacent empty space; `experiments/pooling.md` has the comparison.

use std::fmt::{Display, Formatter};
use std::str::FromStr;

use super::shrinkage::Shrinkage;
use super::{VertexSums, trace};
use crate::octree::around;
use crate::{Error, Result};

/// How a vertex near few rays uses the sums of its neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Pooling {
    /// Not at all, as in the paper.
    #[default]
    Off,
    /// The more, the fewer rays its neighbourhood has below this number.
    Below(f64),
    /// By shrinkage towards what surrounds it, which fades as rays grow.
    Auto,
}

impl Pooling {
    /// Whether sums are pooled.
    #[must_use]
    pub fn is_on(self) -> bool {
        self != Self::Off
    }

    /// Whether this is a setting that a run can have.
    #[must_use]
    pub fn is_possible(self) -> bool {
        !matches!(self, Self::Below(rays) if !(rays > 0.0 && rays.is_finite()))
    }
}

/// As the option `--min-rays` spells it: `auto`, or a number of rays.
impl Display for Pooling {
    fn fmt(&self, f: &mut Formatter) -> std::fmt::Result {
        match self {
            Self::Off => write!(f, "0"),
            Self::Below(rays) => write!(f, "{rays}"),
            Self::Auto => write!(f, "auto"),
        }
    }
}

impl FromStr for Pooling {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        match text.parse::<f64>() {
            Ok(0.0) => Ok(Self::Off),
            Ok(rays) if Self::Below(rays).is_possible() => Ok(Self::Below(rays)),
            _ => Err(Error::setting("min-rays", "`auto`, or a number of rays from 0 on", text)),
        }
    }
}

/// How sums are pooled, with what each way needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pooler {
    /// Not at all.
    Off,
    /// Vertex by vertex.
    Tent(Tent),
    /// Block by block.
    Shrinkage(Shrinkage),
}

/// Pools a vertex whose neighbourhood has few rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tent {
    /// Requested number of rays m.
    pub min_rays: f64,
    /// Vertices with no more information (tr S) than this have not moved, and their rays do not count.
    pub floor: f64,
}

impl Tent {
    /// The pooled sums at the lattice point `center` of a lattice {0..`last`}³ whose sums are `at`.
    ///
    /// The ray count remains that of the point itself.
    #[must_use]
    pub fn pooled(&self, center: [u32; 3], last: u32, at: impl Fn([u32; 3]) -> Option<VertexSums>) -> VertexSums {
        let own = at(center).unwrap_or_default();
        let mut information = [0.0; 6];
        let (mut total, mut most) = (0.0, 0_u32);
        for (point, tent) in around(center, last) {
            total += tent;
            let Some(e) = at(point) else { continue };
            information.iter_mut().zip(e.information).for_each(|(s, v)| *s += tent * v);
            if trace(&e.information) > self.floor {
                most = most.max(e.rays);
            }
        }
        let cubes = [f64::from(most), 0.5 * self.min_rays].map(|n| n * n * n);
        let share = cubes[0] / (cubes[0] + cubes[1]);
        let mix = |own: f64, sum: f64| share * own + (1.0 - share) * sum / total;
        VertexSums::new(std::array::from_fn(|k| mix(own.information[k], information[k])), own.rays)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POOLING: Tent = Tent { min_rays: 4.0, floor: 0.5 };

    fn seen(xx: f64, rays: u32) -> VertexSums {
        VertexSums::new([xx, 0.0, 0.0, 0.0, 0.0, 0.0], rays)
    }

    /// Pools at `center` of a lattice on which only `points` were seen.
    fn pool(center: [u32; 3], points: &[([u32; 3], VertexSums)]) -> VertexSums {
        POOLING.pooled(center, 8, |p| points.iter().find(|(q, _)| *q == p).map(|(_, e)| *e))
    }

    #[test]
    fn many_rays_speak_for_themselves() {
        // n = 200: w = 1 − 1e-6.
        let points = [([4, 4, 4], seen(3.0, 200)), ([5, 4, 4], seen(900.0, 7))];
        let found = pool([4, 4, 4], &points);
        assert!((found.information[0] - 3.0).abs() < 1e-6 * 900.0 && found.rays == 200, "{found:?}");
        // An empty vertex next to them is known to be empty, because as many rays passed it.
        assert!(pool([4, 4, 3], &points).information[0] < 1e-6 * 900.0);
    }

    #[test]
    fn few_rays_are_shared_among_neighbours() {
        // Two rays at one of 27 points: w = ½. The tent weights sum to 2³ = 8; the centre's is 1.
        let points = [([4, 4, 4], seen(8.0, 2))];
        assert!((pool([4, 4, 4], &points).information[0] - (0.5 * 8.0 + 0.5 * 1.0)).abs() < 1e-12);
        assert!((pool([5, 4, 4], &points).information[0] - 0.5 * 0.5).abs() < 1e-12);
        assert!((pool([5, 3, 5], &points).information[0] - 0.5 * 0.125).abs() < 1e-12);
        assert_eq!(pool([6, 4, 4], &points), VertexSums::default());
        // Apart from the vertices' own weight, pooling preserves the total.
        let sum: f64 = around([4, 4, 4], 8).map(|(p, _)| pool(p, &points).information[0]).sum();
        assert!((sum - 8.0).abs() < 1e-12);
    }

    #[test]
    fn negligible_vertices_do_not_count_as_seen() {
        let points = [([4, 4, 4], seen(0.4, 1000)), ([5, 4, 4], seen(8.0, 2))];
        assert!((pool([4, 4, 4], &points).information[0] - (0.5 * 0.4 + 0.5 * (0.4 / 8.0 + 0.5))).abs() < 1e-12);
    }

    #[test]
    fn at_a_corner_of_the_cube_weights_still_sum_to_one() {
        // Eight points lie within the cube. Their weights sum to (1 + ½)³ = 3.375.
        let points = [([8, 8, 8], seen(3.375, 1))];
        let share = 1.0 / 9.0;
        assert!((pool([8, 8, 8], &points).information[0] - (share * 3.375 + (1.0 - share))).abs() < 1e-12);
    }

    #[test]
    fn settings_are_read_as_they_are_written() {
        for (text, pooling) in
            [("0", Pooling::Off), ("4", Pooling::Below(4.0)), ("0.5", Pooling::Below(0.5)), ("auto", Pooling::Auto)]
        {
            assert_eq!(text.parse::<Pooling>().unwrap(), pooling);
            assert_eq!(pooling.to_string(), text);
        }
        for text in ["-1", "nan", "inf", "some", ""] {
            let error = text.parse::<Pooling>().unwrap_err().to_string();
            assert!(error.contains("`auto`, or a number of rays from 0 on"), "{error}");
        }
    }
}
