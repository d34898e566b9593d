//! One half of the space around a scene.

use glam::DVec3;

/// A half of space that training cameras may stand in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Hemisphere {
    /// x < 0
    Left,
    /// x > 0
    Right,
    /// y < 0
    Front,
    /// y > 0
    Back,
}

impl Hemisphere {
    /// Whether a point at `offset` from the scene's middle lies inside.
    #[must_use]
    pub fn contains(self, offset: DVec3) -> bool {
        match self {
            Self::Left => offset.x < 0.0,
            Self::Right => offset.x > 0.0,
            Self::Front => offset.y < 0.0,
            Self::Back => offset.y > 0.0,
        }
    }
}
