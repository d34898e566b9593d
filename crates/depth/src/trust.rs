//! Which depths can be trusted, and why others cannot.

use octobayes::geometry::Camera;
use octobayes::render::RenderedView;

use super::TrainingViews;
use super::training_views::{CONFIRMING_VIEWS, Sighting};

octobayes::choices! {
    /// Whether the depth of a pixel can be trusted. The first reason that applies counts.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
    pub enum Trust {
        Transparent = "transparent", "more than half of the light passes: there is no surface";
        NeverSeen = "never seen", "no other training camera sees the place";
        InFront = "in front", "most other training cameras that see the place see through it";
        NoAgreement = "no agreement", "fewer than three training cameras see a surface there";
        Trusted = "trusted", "three or more training cameras see a surface there";
    }
}

impl Trust {
    /// Its grey in `NAME.trust.png`.
    #[must_use]
    pub fn grey(self) -> u8 {
        match self {
            Self::Transparent => 0,
            Self::NeverSeen => 64,
            Self::InFront => 128,
            Self::NoAgreement => 192,
            Self::Trusted => 255,
        }
    }

    /// The trust in what other cameras see so. `is_own` says whether the view is that of a training camera, too, which
    /// sees its own surface.
    fn of(Sighting { views, agreeing }: Sighting, is_own: bool) -> Self {
        if views == 0 {
            Self::NeverSeen
        } else if 2 * agreeing < views {
            Self::InFront
        } else if agreeing + usize::from(is_own) < CONFIRMING_VIEWS {
            Self::NoAgreement
        } else {
            Self::Trusted
        }
    }

    /// `[height · width]`: the trust in the median depth of every pixel of a view: that of the training camera
    /// `own`, or another.
    #[must_use]
    pub fn of_view(
        training: &TrainingViews,
        camera: &Camera,
        pixel_offset: f64,
        view: &RenderedView,
        own: Option<usize>,
    ) -> Vec<Self> {
        let of = |(pixel, x): (&octobayes::render::Pixel, glam::DVec3)| {
            if pixel.opacity > 0.5 { Self::of(training.sighting_but(x, own), own.is_some()) } else { Self::Transparent }
        };
        view.median_points(camera, pixel_offset).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_reason_counts_and_the_own_view_does_not() {
        let of = |views, agreeing, own| Trust::of(Sighting { views, agreeing }, own);
        assert_eq!(of(0, 0, false), Trust::NeverSeen);
        assert_eq!((of(1, 1, true), of(2, 2, true)), (Trust::NoAgreement, Trust::Trusted));
        assert_eq!(
            (of(4, 1, true), of(4, 2, true), of(4, 2, false)),
            (Trust::InFront, Trust::Trusted, Trust::NoAgreement)
        );
        assert_eq!((of(6, 3, false), of(2, 2, false)), (Trust::Trusted, Trust::NoAgreement));
        let mut greys = Trust::ALL.map(Trust::grey);
        greys.sort_unstable();
        greys.windows(2).for_each(|pair| assert!(pair[0] < pair[1]));
    }
}
