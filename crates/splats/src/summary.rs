//! What a file of splats holds, in a few numbers.

use serde::Serialize;

use super::{RenderMode, Splats};
use octobayes::metrics::quantile;

/// The quantiles of [`Summary`].
pub const QUANTILES: [f64; 5] = [0.0, 0.01, 0.5, 0.99, 1.0];

/// Numbers that describe a scene. A list of five has the [`QUANTILES`]: floaters lie far outside a scene, so that its
/// extent is between the second and the fourth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Number of splats.
    pub count: usize,
    /// Degree of the spherical harmonics.
    pub degree: u8,
    /// How small splats are drawn.
    pub mode: RenderMode,
    /// Quantiles of the means along x, y and z, scene units.
    pub means: [[f32; 5]; 3],
    /// Quantiles of the largest standard deviation of a splat, scene units.
    pub largest_scales: [f32; 5],
    /// Quantiles of the smallest standard deviation of a splat, scene units.
    pub smallest_scales: [f32; 5],
    /// Quantiles of the opacity.
    pub opacities: [f32; 5],
    /// Names of properties that have no meaning here.
    pub extras: Vec<String>,
    /// Size in memory, bytes.
    pub memory: usize,
}

fn quantiles(values: impl Iterator<Item = f32>) -> [f32; 5] {
    let mut sorted: Vec<f64> = values.map(f64::from).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    QUANTILES.map(|share| quantile(&sorted, share) as f32)
}

impl Splats {
    /// Describes the scene in a few numbers.
    #[doc(hidden)]
    #[must_use]
    pub fn summary(&self) -> Summary {
        let all = || 0..self.len();
        Summary {
            count: self.len(),
            degree: self.degree(),
            mode: self.mode(),
            means: [0, 1, 2].map(|axis: usize| quantiles(self.means().iter().map(|mean| mean[axis]))),
            largest_scales: quantiles(all().map(|i| self.scale(i).max_element())),
            smallest_scales: quantiles(all().map(|i| self.scale(i).min_element())),
            opacities: quantiles(all().map(|i| self.opacity(i))),
            extras: self.extra_names().into_iter().map(str::to_string).collect(),
            memory: self.memory(),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::*;

    #[test]
    fn floaters_lie_outside_the_inner_quantiles() {
        let n = 201;
        let mut means: Vec<Vec3> = (0..n).map(|i| Vec3::new(i as f32 / 200.0, 1.0, -(i as f32))).collect();
        means[100].x = 1e6;
        let scales = vec![Vec3::new(0.0, -1.0, -2.0); n];
        let (rotations, sh) = (vec![Quat::IDENTITY; n], vec![0.0; 3 * n]);
        let splats = Splats::new(means, scales, rotations, vec![0.0; n], sh, 0, RenderMode::Mip).unwrap();
        let Summary { count, degree, mode, means, largest_scales, smallest_scales, opacities, extras, memory } =
            splats.summary();
        assert_eq!((count, degree, mode, extras.len()), (n, 0, RenderMode::Mip, 3));
        assert_eq!(means[0], [0.0, 0.01, 101.0 / 200.0, 199.0 / 200.0, 1e6]);
        assert_eq!(means[2], [-200.0, -198.0, -100.0, -2.0, 0.0]);
        assert_eq!((largest_scales, opacities), ([1.0; 5], [0.5; 5]));
        assert_eq!(smallest_scales, [(-2.0_f32).exp(); 5]);
        assert_eq!(memory, n * (12 + 12 + 16 + 4 + 12 + 12));
    }
}
