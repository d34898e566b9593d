//! Which pixels of depth maps hold a measurement, and which do not.

use std::fmt;
use std::ops::AddAssign;

use serde::Serialize;

/// Why a pixel of a depth map holds no measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unmeasured {
    /// 0, which means "unknown".
    Zero,
    /// NaN or infinite.
    NotFinite,
    /// Not in front of the camera.
    Negative,
    /// A value for "nothing here": the largest that the type holds, 65504 of f16, or the 1e10 of Blender's Cycles.
    ///
    /// The largest value of a PNG at best means "this far or farther".
    Largest,
    /// Farther away than anything that the model could show ([`DepthMap::within`](super::DepthMap::within)).
    Beyond,
}

/// Counts what the pixels of depth maps hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct DepthReadings {
    /// Pixels with a usable depth.
    pub measured: u64,
    /// Pixels with 0.
    pub zero: u64,
    /// Pixels with NaN or ∞.
    pub not_finite: u64,
    /// Pixels with a depth that is not in front of the camera.
    pub negative: u64,
    /// Pixels with a value for "nothing here".
    pub largest: u64,
    /// Pixels with a depth beyond the model's reach.
    pub beyond: u64,
}

/// Of so many pixels at least one must hold a measurement. Otherwise the maps are in another unit, or of something
/// else.
const MIN_READINGS: u64 = 100;

impl DepthReadings {
    /// Counts a pixel.
    pub fn count(&mut self, pixel: Result<f64, Unmeasured>) {
        *match pixel {
            Ok(_) => &mut self.measured,
            Err(Unmeasured::Zero) => &mut self.zero,
            Err(Unmeasured::NotFinite) => &mut self.not_finite,
            Err(Unmeasured::Negative) => &mut self.negative,
            Err(Unmeasured::Largest) => &mut self.largest,
            Err(Unmeasured::Beyond) => &mut self.beyond,
        } += 1;
    }

    /// Pixels without a measurement, by reason.
    fn reasons(&self) -> [(u64, &'static str); 5] {
        [
            (self.zero, "0, unknown"),
            (self.not_finite, "NaN or infinite"),
            (self.negative, "not in front of the camera"),
            (self.largest, "the value for no surface"),
            (self.beyond, "beyond the model's reach"),
        ]
    }

    /// Number of pixels.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.measured + self.reasons().iter().map(|(n, _)| n).sum::<u64>()
    }

    /// Returns true if nearly all pixels are without a measurement: more than 99 of 100.
    #[must_use]
    pub fn are_nearly_all_unmeasured(&self) -> bool {
        MIN_READINGS * self.measured < self.total()
    }
}

impl AddAssign for DepthReadings {
    fn add_assign(&mut self, other: Self) {
        let Self { measured, zero, not_finite, negative, largest, beyond } = other;
        self.measured += measured;
        self.zero += zero;
        self.not_finite += not_finite;
        self.negative += negative;
        self.largest += largest;
        self.beyond += beyond;
    }
}

/// The largest depth of maps and how many pixels hold it, in their own quantity ([`DepthKind`](super::DepthKind)).
///
/// Programs that end their view at a far plane write its depth where there is no surface. If it is nearer than
/// everything that the model could show, it looks like a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LargestDepth {
    /// The largest depth, in scene units.
    pub depth: f64,
    /// Number of pixels that hold exactly this depth.
    pub pixels: u64,
}

impl LargestDepth {
    /// Depths are equal up to the rounding of [`DepthKind::stretch`](super::DepthKind::stretch) and back.
    const ROUNDING: f64 = 1e-12;

    /// Of surfaces, hardly any two pixels have the same depth; a wall of 8-bit maps may be an exception.
    const MAX_SHARE_OF_SURFACES: f64 = 0.02;

    /// Fewer pixels may agree by chance.
    const MIN_READINGS: u64 = 100;

    /// Counts pixels of this depth.
    pub fn count(&mut self, other: Self) {
        if (other.depth - self.depth).abs() <= Self::ROUNDING * self.depth {
            self.pixels += other.pixels;
        } else if other.depth > self.depth {
            *self = other;
        }
    }

    /// The sentence that this depth is probably a far plane, if it is, among so many measurements.
    #[must_use]
    pub fn doubt(&self, measured: u64) -> Option<String> {
        let share = self.pixels as f64 / measured.max(1) as f64;
        let percent = 100.0 * share;
        (share > Self::MAX_SHARE_OF_SURFACES && self.pixels >= Self::MIN_READINGS).then(|| {
            format!(
                "{percent:.1} % of the depths are exactly {}, the largest of all: if it stands for no surface, as a \
                 far plane does, write 0 or inf there",
                self.depth as f32
            )
        })
    }
}

/// The share of pixels without a measurement, with the reasons.
impl fmt::Display for DepthReadings {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let percent = |n: u64| 100.0 * n as f64 / self.total().max(1) as f64;
        write!(f, "{:.1} % of depth readings are not measurements", percent(self.total() - self.measured))?;
        let reasons: Vec<String> = self
            .reasons()
            .into_iter()
            .filter(|(n, _)| *n > 0)
            .map(|(n, reason)| format!("{reason}: {:.1} %", percent(n)))
            .collect();
        if reasons.is_empty() { Ok(()) } else { write!(f, " ({})", reasons.join("; ")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_become_shares_with_their_reasons() {
        let mut readings = DepthReadings::default();
        assert!(!readings.are_nearly_all_unmeasured(), "of no pixels");
        let all = [Unmeasured::Zero, Unmeasured::NotFinite, Unmeasured::Negative, Unmeasured::Largest];
        all.into_iter().for_each(|reason| readings.count(Err(reason)));
        (0..2).for_each(|_| readings.count(Err(Unmeasured::Beyond)));
        (0..10).for_each(|_| readings.count(Ok(1.0)));
        assert_eq!(readings.total(), 16);
        assert_eq!(
            readings.to_string(),
            "37.5 % of depth readings are not measurements (0, unknown: 6.2 %; NaN or infinite: 6.2 %; not in front \
             of the camera: 6.2 %; the value for no surface: 6.2 %; beyond the model's reach: 12.5 %)"
        );
        let mut twice = readings;
        twice += readings;
        assert_eq!((twice.total(), twice.to_string()), (32, readings.to_string()));
        // One measurement in a hundred is enough, one in 101 is not.
        let few = |beyond| DepthReadings { measured: 1, beyond, ..DepthReadings::default() };
        assert_eq!([99, 100].map(|beyond| few(beyond).are_nearly_all_unmeasured()), [false, true]);
    }

    #[test]
    fn a_far_plane_is_told_from_a_wall_of_many_depths() {
        let mut largest = LargestDepth::default();
        for i in 0..1000 {
            largest.count(LargestDepth { depth: 3.0 + 1e-3 * f64::from(i % 500), pixels: 1 });
        }
        assert_eq!((largest.pixels, largest.doubt(1000)), (2, None));
        largest.count(LargestDepth { depth: 4.0, pixels: 1 });
        assert_eq!(largest, LargestDepth { depth: 4.0, pixels: 1 });
        // Rounding is no difference.
        largest.count(LargestDepth { depth: 4.0 * (1.0 + f64::EPSILON), pixels: 199 });
        let said = largest.doubt(1200).unwrap();
        assert!(said.starts_with("16.7 % of the depths are exactly 4, the largest"), "{said}");
        assert_eq!(largest.doubt(10_001), None, "less than a fiftieth");
    }
}
