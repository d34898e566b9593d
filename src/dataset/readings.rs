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
const FEWEST: u64 = 100;

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
        FEWEST * self.measured < self.total()
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
}
