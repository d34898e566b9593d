//! Samples from elsewhere, as they arrive one by one, in batches.

use crate::render::{RaySample, RaySamples};

/// The largest number of samples of a ray. A ray through a model has no more steps.
pub const MOST_SAMPLES: usize = 1 << 16;
/// A batch ends with its ray after so many rays, or samples.
const RAYS: usize = 512;
const SAMPLES: usize = 1 << 17;

/// Batches of samples, cut only between rays, because a ray is summed as a whole.
#[derive(Debug)]
pub struct Gathered {
    /// Rays drawn, including those without samples.
    total: u64,
    /// The last ray, and the number of its samples.
    ray: u64,
    of_ray: usize,
    batches: Vec<RaySamples>,
}

impl Gathered {
    /// No samples yet, of `total` rays.
    #[must_use]
    pub fn new(total: u64) -> Self {
        Self { total, ray: 0, of_ray: 0, batches: vec![RaySamples::default()] }
    }

    /// Adds a sample of a ray. Returns the number of samples of a batch that is complete by that.
    ///
    /// # Errors
    /// What is wrong with the ray, as (expected, found): its index decreases or reaches the total, or it has too many
    /// samples.
    pub fn push(&mut self, ray: u64, sample: RaySample) -> Result<Option<usize>, (String, String)> {
        if ray < self.ray || ray >= self.total {
            let expected = format!("from {} (non-decreasing) to below rays_total = {}", self.ray, self.total);
            return Err((expected, ray.to_string()));
        }
        let is_new = ray != self.ray;
        self.of_ray = if is_new { 1 } else { self.of_ray + 1 };
        if self.of_ray > MOST_SAMPLES {
            return Err((format!("at most {MOST_SAMPLES} samples of a ray"), "more".into()));
        }
        self.ray = ray;
        let last = &self.batches[self.batches.len() - 1];
        let samples = last.positions.len();
        let complete = (is_new && (last.rays.len() >= RAYS || samples >= SAMPLES)).then_some(samples);
        if complete.is_some() {
            self.batches.push(RaySamples::default());
        }
        if let Some(batch) = self.batches.last_mut() {
            batch.push(ray, sample);
        }
        Ok(complete)
    }

    /// Takes the complete batches, if they are at least so many.
    pub fn take(&mut self, least: usize) -> Option<Vec<RaySamples>> {
        let complete = self.batches.len() - 1;
        (complete >= least).then(|| self.batches.drain(..complete).collect())
    }

    /// The batches that are left.
    #[must_use]
    pub fn finish(self) -> Vec<RaySamples> {
        self.batches
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// The sizes of the batches of rays with so many samples each.
    fn sizes(rays: u64, samples: usize) -> Result<Vec<usize>, (String, String)> {
        let mut gathered = Gathered::new(rays);
        let sample = RaySample { position: Vec3::ZERO, jacobian: [1.0; 9], weight: 0.5 };
        for ray in 0..rays {
            (0..samples).try_for_each(|_| gathered.push(ray, sample).map(drop))?;
        }
        Ok(gathered.finish().iter().map(|batch| batch.positions.len()).collect())
    }

    #[test]
    fn batches_end_by_their_rays_or_their_samples() {
        assert_eq!(sizes(1030, 3).unwrap(), [512 * 3, 512 * 3, 6 * 3]);
        let long = SAMPLES / 4 + 1;
        assert_eq!(sizes(5, long).unwrap(), [4 * long, long]);
    }

    #[test]
    fn a_ray_has_no_more_samples_than_a_model_has_steps() {
        assert_eq!(sizes(2, MOST_SAMPLES).unwrap(), [2 * MOST_SAMPLES]);
        assert_eq!(sizes(1, MOST_SAMPLES + 1).unwrap_err().0, "at most 65536 samples of a ray");
    }

    #[test]
    fn complete_batches_are_taken_and_the_last_one_stays() {
        let mut gathered = Gathered::new(2000);
        let sample = RaySample { position: Vec3::ZERO, jacobian: [1.0; 9], weight: 0.5 };
        let complete: Vec<Option<usize>> = (0..1025).map(|ray| gathered.push(ray, sample).unwrap()).collect();
        assert_eq!(complete.iter().flatten().copied().collect::<Vec<_>>(), [512, 512]);
        assert!(gathered.take(3).is_none());
        assert_eq!(gathered.take(2).unwrap().len(), 2);
        let rest = gathered.finish();
        assert_eq!(rest.iter().map(|batch| batch.rays.clone()).collect::<Vec<_>>(), [vec![1024]]);
    }
}
