//! Hyper-parameters, named as in instant-ngp (Müller, Evans, Schied, Keller, "Instant Neural Graphics Primitives with a
//! Multiresolution Hash Encoding", SIGGRAPH 2022, Table 1).

use serde::{Deserialize, Serialize};

use octobayes::{Error, Result};

/// Levels of the hash grid.
pub const N_LEVELS: usize = 8;
/// Features per entry. Four fill a vector register and come with one memory access, so that 8 × 4 features
/// cost half the accesses of the paper's 16 × 2.
pub const N_FEATURES_PER_LEVEL: usize = 4;
/// Width of hidden layers.
pub const N_NEURONS: usize = 32;
/// Outputs of the density network; the first is log σ.
pub const N_GEOMETRY: usize = 16;
/// Largest number of cells per axis of the occupancy grid.
pub(super) const MAX_OCCUPANCY: usize = 128;

/// Largest resolution of a level; positions are only f32.
const MAX_RESOLUTION: f64 = 65_536.0;

octobayes::setters! {
    /// The configurable part of a hash grid.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[non_exhaustive]
    pub struct HashGridConfig {
        /// log2 of T, the largest number of entries per level; 8 to 22. Smaller tables collide more, larger ones
        /// leave the caches.
        pub log2_hashmap_size: u32,
        /// Cells per axis of the coarsest level.
        pub base_resolution: u32,
        /// Ratio of the resolutions of neighbouring levels, 1 to 4.
        pub per_level_scale: f64,
        /// Cells per axis of the occupancy grid, a multiple of 4 up to 128.
        pub occupancy: usize,
    }
}

impl Default for HashGridConfig {
    fn default() -> Self {
        Self { log2_hashmap_size: 16, base_resolution: 16, per_level_scale: 1.5, occupancy: 64 }
    }
}

impl HashGridConfig {
    /// Cells per axis of every level.
    #[must_use]
    pub fn resolutions(&self) -> [u32; N_LEVELS] {
        let mut resolution = f64::from(self.base_resolution);
        std::array::from_fn(|_| {
            let this = resolution as u32;
            resolution *= self.per_level_scale;
            this
        })
    }

    /// Returns the configuration if its numbers make sense.
    ///
    /// # Errors
    /// Names the first number that does not.
    pub fn checked(self) -> Result<Self> {
        let finest = f64::from(self.base_resolution) * self.per_level_scale.powi(N_LEVELS as i32 - 1);
        let wrong = |what: &str, expected: String, found: String| Err(Error::setting(what, expected, found));
        if !(8..=22).contains(&self.log2_hashmap_size) {
            return wrong("log2_hashmap_size", "8 to 22".into(), self.log2_hashmap_size.to_string());
        }
        if !(1.0..=4.0).contains(&self.per_level_scale) {
            return wrong("per_level_scale", "1 to 4".into(), self.per_level_scale.to_string());
        }
        if self.base_resolution == 0 || finest > MAX_RESOLUTION {
            let expected = format!("levels of 1 to {MAX_RESOLUTION} cells per axis");
            return wrong("base_resolution", expected, format!("{} to {finest}", self.base_resolution));
        }
        if !(4..=MAX_OCCUPANCY).contains(&self.occupancy) || !self.occupancy.is_multiple_of(4) {
            let expected = format!("a multiple of 4 up to {MAX_OCCUPANCY}");
            return wrong("occupancy", expected, self.occupancy.to_string());
        }
        Ok(self)
    }
}
