//! How splats that are smaller than a pixel are drawn.

octobayes::choices! {
    /// How splats that are smaller than a pixel are drawn. It is part of the model: splats look right only as they were
    /// trained.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    pub enum RenderMode {
        /// As in the original code: every splat grows by 0.3 px², and keeps its opacity.
        #[default]
        Classic = "classic", "as the original code: small splats grow by 0.3 px^2 and keep their opacity";
        /// As in gsplat's antialiased mode: every splat grows by 0.3 px², and what it gains in area it loses in opacity
        /// (Yu et al., "Mip-Splatting", 2024, §4.2).
        Mip = "mip", "as gsplat's `antialiased`: what a splat gains in area it loses in opacity";
        /// As in the code of Mip-Splatting, whose splats grow by 0.1 px².
        MipSplatting = "mip-splatting", "as Mip-Splatting's code: the same, but splats grow by 0.1 px^2";
    }
}

impl RenderMode {
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
