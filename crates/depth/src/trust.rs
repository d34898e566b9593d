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

    /// The trust in what cameras see so. `own` says whether the view is that of one of them, which always sees its own
    /// surface.
    fn of(Sighting { views, agreeing }: Sighting, own: bool) -> Self {
        let others = views.saturating_sub(usize::from(own));
        let others_agreeing = agreeing.saturating_sub(usize::from(own));
        if others == 0 {
            Self::NeverSeen
        } else if 2 * others_agreeing < others {
            Self::InFront
        } else if agreeing < CONFIRMING_VIEWS {
            Self::NoAgreement
        } else {
            Self::Trusted
        }
    }

    /// `[height · width]`: the trust in the median depth of every pixel of a view; `own` if a training camera has it.
    #[must_use]
    pub fn of_view(
        training: &TrainingViews,
        camera: &Camera,
        pixel_offset: f64,
        view: &RenderedView,
        own: bool,
    ) -> Vec<Self> {
        let of = |(pixel, x): (&octobayes::render::Pixel, glam::DVec3)| {
            if pixel.opacity > 0.5 { Self::of(training.sighting(x), own) } else { Self::Transparent }
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
        assert_eq!((of(1, 1, true), of(1, 1, false)), (Trust::NeverSeen, Trust::NoAgreement));
        assert_eq!(
            (of(4, 1, false), of(4, 2, false), of(4, 2, true)),
            (Trust::InFront, Trust::NoAgreement, Trust::InFront)
        );
        assert_eq!(
            (of(3, 3, true), of(6, 3, false), of(2, 2, true)),
            (Trust::Trusted, Trust::Trusted, Trust::NoAgreement)
        );
        let mut greys = Trust::ALL.map(Trust::grey);
        greys.sort_unstable();
        greys.windows(2).for_each(|pair| assert!(pair[0] < pair[1]));
    }
}
