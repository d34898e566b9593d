//! Disagreement between the members of an ensemble, per pixel.
//!
//! Variances are population variances: the divisor is the number of members.

use glam::DVec3;

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Variance of a pixel's depth over the members, in squared scene units (deep ensembles, Lakshminarayanan et al.
/// 2017, applied to depth).
#[must_use]
pub fn ensemble_variance(depths: &[f64]) -> f64 {
    let mean = mean(depths);
    depths.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / depths.len() as f64
}

/// ψ² of density-aware ensembles (Sünderhauf, Abou-Chakra, Miller 2023).
///
/// The variance of the colour over the members, averaged over channels, plus (1 − q̄)². Here q̄ is the mean opacity
/// of the members: the probability that the ray ends somewhere.
#[must_use]
pub fn density_aware(colors: &[DVec3], opacities: &[f64]) -> f64 {
    let channel = |k: usize| ensemble_variance(&colors.iter().map(|c| c[k]).collect::<Vec<_>>());
    let unseen = 1.0 - mean(opacities);
    (channel(0) + channel(1) + channel(2)) / 3.0 + unseen * unseen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_members_that_disagree() {
        assert_eq!(ensemble_variance(&[2.0, 4.0]), 1.0);
        assert_eq!(ensemble_variance(&[3.0; 10]), 0.0);
        // Red differs by 1: its variance 1/4 counts by a third. Mean opacity is ¾: the unseen part adds (1/4)².
        let colors = [DVec3::new(0.0, 0.2, 0.7), DVec3::new(1.0, 0.2, 0.7)];
        assert!((density_aware(&colors, &[1.0, 0.5]) - (0.25 / 3.0 + 0.0625)).abs() < 1e-15);
        // Members that agree on showing nothing are uncertain; members that agree on an opaque surface are certain.
        assert_eq!(density_aware(&[DVec3::ONE; 3], &[0.0; 3]), 1.0);
        assert_eq!(density_aware(&[DVec3::ONE; 3], &[1.0; 3]), 0.0);
    }
}
