//! Disagreement between the members of an ensemble, per pixel.

/// Population variance of a pixel's depth over the members, in squared scene units (deep ensembles, Lakshminarayanan et
/// al. 2017, applied to depth).
#[must_use]
pub fn ensemble_variance(depths: &[f64]) -> f64 {
    let mean = depths.iter().sum::<f64>() / depths.len() as f64;
    depths.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / depths.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_members_that_disagree() {
        assert_eq!(ensemble_variance(&[2.0, 4.0]), 1.0);
        assert_eq!(ensemble_variance(&[3.0; 10]), 0.0);
    }
}
