//! One half of the space around a scene.

use glam::DVec3;

octobayes::choices! {
    /// A half of space that training cameras may stand in.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
    pub enum Hemisphere {
        Left = "left", "x < 0";
        Right = "right", "x > 0";
        Front = "front", "y < 0";
        Back = "back", "y > 0";
    }
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
