//! The splats that an image point shows.

use glam::DVec2;

use super::SplatView;
use super::project::FAINTEST;

/// Largest α: light always passes.
pub const MOST_OPAQUE: f64 = 0.99;
/// No splat is drawn behind which less light would be left.
pub const MIN_TRANSMITTANCE: f64 = 1e-4;

/// A splat that an image point shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    pub(super) footprint: u32,
    /// α.
    pub alpha: f64,
    /// T, before it.
    pub before: f64,
    /// v = A (m − p), 1 / pixel.
    pub(super) v: DVec2,
    /// Whether α is limited, and so does not depend on where the splat is.
    pub(super) is_limited: bool,
}

impl Hit {
    /// w = T α, its share of the pixel's colour.
    #[must_use]
    pub fn weight(&self) -> f64 {
        self.before * self.alpha
    }
}

/// The splats that an image point shows, front to back. The list is reused from point to point.
#[derive(Debug, Clone, Default)]
pub struct Hits {
    /// The splats.
    pub list: Vec<Hit>,
    /// T_end, the light that passes all of them.
    pub passed: f64,
    /// `[list]`: G, if it was requested.
    pub(super) jacobians: Vec<[f32; 9]>,
}

impl SplatView<'_> {
    /// Depth of a hit's centre along the view axis, scene units.
    #[must_use]
    pub fn depth(&self, hit: &Hit) -> f64 {
        self.footprints[hit.footprint as usize].depth
    }

    /// Finds what is shown at an image point, pixels from the top left corner.
    pub fn hits(&self, at: [f64; 2], hits: &mut Hits) {
        let p = DVec2::from(at);
        let mut transmittance = 1.0;
        hits.list.clear();
        self.tiles.visit(at, |number| {
            let footprint = &self.footprints[number as usize];
            let d = footprint.mean - p;
            let [a, b, c] = footprint.conic;
            let v = DVec2::new(a * d.x + b * d.y, b * d.x + c * d.y);
            let free = footprint.opacity * (-0.5 * d.dot(v)).exp();
            let alpha = free.min(MOST_OPAQUE);
            if alpha < FAINTEST {
                return true;
            }
            let left = transmittance * (1.0 - alpha);
            if left < MIN_TRANSMITTANCE {
                return false;
            }
            let is_limited = free >= MOST_OPAQUE;
            hits.list.push(Hit { footprint: number, alpha, before: transmittance, v, is_limited });
            transmittance = left;
            true
        });
        hits.passed = transmittance;
    }
}
