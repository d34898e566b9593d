//! How many rays are in flight: fewer of those with many samples, as through fog or unbounded scenes.
//!
//! Before they are summed, a sample's contributions to the eight corners of its cell take up to 448 bytes, and what its
//! derivatives are computed from some 500. The division changes no bit of a result: rays are summed in their order,
//! however they were divided.

use super::shard::{BATCH, RunProgress};

/// Most batches that are drawn, and passed to the posterior, together.
pub(super) const GROUP: u64 = 16;
/// About how many samples a thread differentiates together.
const SAMPLES_TOGETHER: f64 = 4096.0;
/// About how many samples are held until they are summed.
const SAMPLES_IN_FLIGHT: f64 = 65_536.0;
/// Rays that are differentiated together at the start, when nothing is known of their samples: what they take stays
/// with the process.
const FIRST_RAYS: u64 = 8;

/// How the work is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Portions {
    /// Rays that are differentiated together, at most.
    pub rays: u64,
    /// Batches that are drawn before they are summed.
    pub batches: u64,
}

impl Portions {
    /// Of a run that has come so far. This does not depend on whether the run was interrupted, nor on threads.
    pub fn after(progress: &RunProgress) -> Self {
        if progress.rays == 0 {
            return Self { rays: FIRST_RAYS, batches: 1 };
        }
        let per_ray = (progress.samples as f64 / progress.rays as f64).max(1.0);
        let within = |most: f64| 1 << ((most / per_ray).max(1.0) as u64).ilog2();
        Self {
            rays: within(SAMPLES_TOGETHER).min(BATCH),
            batches: within(SAMPLES_IN_FLIGHT / BATCH as f64).clamp(1, GROUP),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn portions_are_smaller_where_rays_have_more_samples() {
        let after = |rays, samples| Portions::after(&RunProgress { rays, samples, ..RunProgress::default() });
        assert_eq!(after(0, 0), Portions { rays: 8, batches: 1 });
        // Nothing was seen; and the few samples of a ray that meets a surface.
        assert_eq!(after(512, 0), Portions { rays: 512, batches: 16 });
        assert_eq!(after(1000, 6400), Portions { rays: 512, batches: 16 });
        // 200 a ray: 16 rays have 3,200, and a batch has 102,400.
        assert_eq!(after(1000, 200_000), Portions { rays: 16, batches: 1 });
        assert_eq!(after(1000, 456_000), Portions { rays: 8, batches: 1 });
        assert_eq!(after(1000, 20_000), Portions { rays: 128, batches: 4 });
        assert_eq!(after(1000, 1_000_000_000), Portions { rays: 1, batches: 1 });
    }
}
