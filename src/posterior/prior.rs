//! The prior precision of a vertex.

use crate::octree::{Octree, mean_volume};

/// The dependence of the prior precision λ on cell size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Prior {
    /// The same λ at every vertex; agrees with the dense grid where nothing was seen
    #[default]
    Uniform,
    /// λ in proportion to the volume of the cells around a vertex: the paper's 1/M^3, level by level
    Volume,
}

impl Prior {
    /// The prior precision at a vertex of `octree`, where `lambda` is its value among finest cells.
    ///
    /// `Volume` uses the mean volume of the leaves in the (up to eight) octants around the vertex. λ grows
    /// eightfold per level, and takes values in between where levels meet.
    #[must_use]
    pub fn at(self, lambda: f64, octree: &Octree, point: [u32; 3]) -> f64 {
        if self == Self::Uniform {
            return lambda;
        }
        lambda * mean_volume(octree.cells(), point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{Cell, Octree};

    #[test]
    fn volume_is_eight_times_lambda_per_level() {
        // One finest cell at the origin of a level-2 octree. Its siblings have the same size; all other leaves
        // have edge 2.
        let octree = Octree::refined(2, [Cell { level: 2, index: [0, 0, 0] }]);
        assert_eq!(Prior::Volume.at(1.0, &octree, [1, 1, 1]), 1.0);
        assert_eq!(Prior::Volume.at(1.0, &octree, [4, 4, 4]), 8.0);
        // Seven octants of volume 8 and one of volume 1.
        assert_eq!(Prior::Volume.at(1.0, &octree, [2, 2, 2]), 57.0 / 8.0);
        assert_eq!(Prior::Uniform.at(1.0, &octree, [4, 4, 4]), 1.0);
    }
}
