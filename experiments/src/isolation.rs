//! How far splats are from each other.

use octobayes_splats::Splats;
use rayon::prelude::*;

/// Neighbours to whose distance a splat's isolation is measured.
const NEIGHBOURS: usize = 8;

/// Mean distance of each splat's nearest neighbours, scene units.
#[must_use]
pub fn isolation(splats: &Splats) -> Vec<f64> {
    let of = |x: &glam::Vec3| {
        let mut distances: Vec<f32> = splats.means().iter().map(|y| x.distance_squared(*y)).collect();
        let near = NEIGHBOURS.min(distances.len() - 1);
        distances.select_nth_unstable_by(near, f32::total_cmp);
        // The splat itself is at distance 0.
        distances[..=near].iter().map(|d| f64::from(d.sqrt())).sum::<f64>() / near.max(1) as f64
    };
    splats.means().par_iter().map(of).collect()
}
