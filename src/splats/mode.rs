//! How splats that are smaller than a pixel are drawn.

use std::fmt;

/// How splats that are smaller than a pixel are drawn. It is part of the model: splats look right only as they were
/// trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RenderMode {
    /// As in the original code: every splat grows by 0.3 px², and keeps its opacity.
    #[default]
    Classic,
    /// As in gsplat's antialiased mode: every splat grows by 0.3 px², and what it gains in area it loses in opacity (Yu
    /// et al., "Mip-Splatting", 2024, §4.2).
    Mip,
    /// As in the code of Mip-Splatting, whose splats grow by 0.1 px².
    MipSplatting,
}

impl RenderMode {
    /// All modes.
    pub const ALL: [Self; 3] = [Self::Classic, Self::Mip, Self::MipSplatting];

    /// Its name on the command line and in Python.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::Mip => "mip",
            Self::MipSplatting => "mip-splatting",
        }
    }

    /// Variance by which every splat grows on the image, pixels²: about what one pixel's width blurs.
    #[must_use]
    pub const fn dilation(self) -> f64 {
        match self {
            Self::Classic | Self::Mip => 0.3,
            Self::MipSplatting => 0.1,
        }
    }

    /// Whether a splat's opacity makes up for its growth.
    #[must_use]
    pub const fn is_compensated(self) -> bool {
        !matches!(self, Self::Classic)
    }
}

impl fmt::Display for RenderMode {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}
