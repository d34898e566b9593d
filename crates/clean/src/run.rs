//! Looks at a model through all training views, removes what they contradict, and looks again.

use glam::{DVec3, Vec3};
use octobayes::geometry::{Camera, Mask};
use octobayes::monitor::{Monitor, Silent, check};
use octobayes::uncertainty::{Estimate, UncertaintyField};
use octobayes::{Error, Result};
use serde::Serialize;

use crate::evidence::Parts;
use crate::rule::Stage;
use crate::views::ListedView;
use crate::{Evidence, Reason, Rule, Strength};

/// Why a part goes, and at which strengths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Removal {
    /// Why.
    pub reason: Reason,
    /// The first strength at which it goes.
    pub strength: Strength,
    /// How far the views contradicted it when it went.
    pub score: f64,
    /// The look by which it went, from 1: the earlier, the surer.
    pub look: usize,
}

/// The parts of a model, splats or cells of a volume, and what goes of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Cleaned {
    /// `[n]`: what goes, at any strength.
    pub removals: Vec<Option<Removal>>,
    /// What the views showed before anything was removed.
    pub evidence: Evidence,
    /// `[n]`: how far the views contradict a part, at the last look at it; at most 1.
    pub scores: Vec<f64>,
    /// Number of pixels that were looked at each time, and of all pixels.
    pub pixels: [u64; 2],
    /// How often they were looked at.
    pub looks: usize,
    /// `[n]`: U at the centre of each part, if a [field](Self::with_field) was given.
    pub uncertainty: Option<Vec<Estimate>>,
}

impl Cleaned {
    /// `[n]`: why a part goes at a strength, if it does.
    #[must_use]
    pub fn removed(&self, strength: Strength) -> Vec<Option<Reason>> {
        let goes = |removal: &Option<Removal>| removal.filter(|removal| removal.strength <= strength);
        self.removals.iter().map(|removal| goes(removal).map(|removal| removal.reason)).collect()
    }

    /// How many parts go at a strength, by [`Reason`].
    #[must_use]
    pub fn counts(&self, strength: Strength) -> [usize; Reason::ALL.len()] {
        let removed = self.removed(strength);
        Reason::ALL.map(|reason| removed.iter().filter(|found| **found == Some(reason)).count())
    }

    /// Share of the visible surfaces that stays [by uncertainty](Self::by_uncertainty), `[Strength]`.
    pub const SURFACES: [f64; 3] = [0.999, 0.99, 0.95];

    /// The same, with the uncertainty of each part. What goes stays the same.
    ///
    /// # Panics
    /// If there is not one centre for each part.
    #[must_use]
    pub fn with_field(self, centers: &[Vec3], field: &UncertaintyField) -> Self {
        assert_eq!(centers.len(), self.removals.len(), "centres of parts");
        Self { uncertainty: Some(field.query_all(centers)), ..self }
    }

    /// The same parts, but log10 U alone decides: what exceeds the limit of a strength goes, as in the clean-up of Bayes'
    /// Rays (Sec. 5.2). What lies outside the field stays, because its U is not known.
    ///
    /// # Panics
    /// If no [field](Self::with_field) was given.
    #[must_use]
    pub fn by_uncertainty(mut self, limits: [f64; 3]) -> Self {
        let uncertainty = self.uncertainty.as_ref().expect("a field was given");
        for (i, removal) in self.removals.iter_mut().enumerate() {
            let Estimate { uncertainty, inside, .. } = uncertainty[i];
            let goes = |strength: &Strength| inside && uncertainty.log10() > limits[*strength as usize];
            let strength = Strength::ALL.into_iter().find(goes);
            let (reason, score) = (Reason::Loose, self.scores[i]);
            *removal = strength.map(|strength| Removal { reason, strength, score, look: 1 });
        }
        self
    }
}

/// A cleaning by training views.
#[derive(Clone, Copy)]
pub struct Clean<'a> {
    pub(crate) cameras: &'a [Camera],
    pub(crate) masks: &'a [Option<Mask>],
    pub(crate) pixel_offset: f64,
    pub(crate) pixels: u64,
    pub(crate) hidden: bool,
    pub(crate) rule: Rule,
    pub(crate) monitor: &'a dyn Monitor,
}

impl<'a> Clean<'a> {
    /// Pixels of all views together that are looked at by default.
    pub const PIXELS: u64 = 2_000_000;

    /// Cleans a model by the cameras that it was trained on.
    #[must_use]
    pub fn new(cameras: &'a [Camera]) -> Self {
        let (pixels, rule) = (Self::PIXELS, Rule::default());
        Self { cameras, masks: &[], pixel_offset: 0.5, pixels, hidden: false, rule, monitor: &Silent }
    }

    /// Which pixels of each camera count, `[cameras]`, if not all.
    #[must_use]
    pub fn masks(self, masks: &'a [Option<Mask>]) -> Self {
        Self { masks, ..self }
    }

    /// Where the ray of a pixel lies in it, pixels; in its middle by default.
    #[must_use]
    pub fn pixel_offset(self, pixel_offset: f64) -> Self {
        Self { pixel_offset, ..self }
    }

    /// How many pixels of all views together are looked at, about; two million by default.
    #[must_use]
    pub fn pixels(self, pixels: u64) -> Self {
        Self { pixels, ..self }
    }

    /// Whether cells of a volume with matter that images hide are parts as well. The views do not contradict them;
    /// [uncertainty](Cleaned::by_uncertainty) may.
    #[must_use]
    pub fn hidden(self, hidden: bool) -> Self {
        Self { hidden, ..self }
    }

    /// With other constants.
    #[doc(hidden)]
    #[must_use]
    pub fn rule(self, rule: Rule) -> Self {
        Self { rule, ..self }
    }

    /// Reports progress, and may be stopped.
    #[must_use]
    pub fn monitor(self, monitor: &'a dyn Monitor) -> Self {
        Self { monitor, ..self }
    }

    /// Refuses to clean without cameras.
    pub(crate) fn check_cameras(&self) -> Result<()> {
        if self.cameras.is_empty() {
            return Err(Error::setting("cameras", "at least one: what they show is what a model is held against", "0"));
        }
        Ok(())
    }

    /// Finds which of the listed parts go at each strength.
    pub(crate) fn decide(&self, listed: &Listing) -> Result<Cleaned> {
        let n = listed.parts.centers.len();
        let looked_at = listed.views.iter().map(ListedView::pixels).sum();
        let all = self.cameras.iter().map(Camera::pixels).sum();
        let evidence = Evidence::of(&listed.views, listed.parts, &vec![true; n]);
        let (removals, scores) = (vec![None; n], vec![0.0; n]);
        let mut cleaned = Cleaned { removals, evidence, scores, pixels: [looked_at, all], looks: 1, uncertainty: None };
        let outside = self.outside(listed.parts.centers, &cleaned.evidence);
        let mut latest = cleaned.evidence.clone();
        for stage in self.rule.stages {
            self.score(&mut cleaned, &latest, stage);
            self.remove_by_look(&mut cleaned, listed, &outside, stage.strength);
            self.remove_floaters(&mut cleaned, &mut latest, listed, stage)?;
        }
        if cleaned.removed(Strength::Careful).iter().all(Option::is_some) {
            let expected = "a scene that the cameras show (are they of another scene, or in another frame?)";
            return Err(Error::setting("model", expected, format!("none of {n} parts in its place")));
        }
        Ok(cleaned)
    }

    /// Removes what one look is enough for.
    fn remove_by_look(&self, cleaned: &mut Cleaned, listed: &Listing, outside: &[bool], strength: Strength) {
        let Cleaned { removals, scores, evidence, .. } = cleaned;
        for (i, (removal, &mut score)) in removals.iter_mut().zip(scores).enumerate() {
            let opacity = listed.opacities.get(i).copied().unwrap_or(1.0);
            let is_hidden = || !listed.may_be_shown[i] && self.rule.is_unseen(evidence, i);
            let reason = match () {
                () if removal.is_some() => continue,
                () if outside[i] => Reason::Outside,
                () if is_hidden() => Reason::Unseen,
                () if f64::from(opacity) < self.rule.opacity[strength as usize] => Reason::Transparent,
                () => continue,
            };
            *removal = Some(Removal { reason, strength, score, look: 1 });
        }
    }

    /// `[n]`: whether a part is far beyond all that the views show.
    fn outside(&self, centers: &[Vec3], of: &Evidence) -> Vec<bool> {
        let middle = self.cameras.iter().map(|camera| camera.position).sum::<DVec3>() / self.cameras.len() as f64;
        let away: Vec<f64> = centers.iter().map(|x| x.as_dvec3().distance(middle)).collect();
        let mut order: Vec<usize> = (0..away.len()).collect();
        order.sort_by(|&a, &b| away[b].total_cmp(&away[a]));
        let most = self.rule.beyond * of.weight.iter().sum::<f64>();
        let mut beyond = 0.0;
        let farthest = order.into_iter().find(|&i| {
            beyond += of.weight[i];
            beyond > most
        });
        let limit = farthest.map_or(f64::INFINITY, |i| self.rule.far * away[i]);
        away.into_iter().map(|away| away > limit).collect()
    }

    /// How far the views contradict the parts that are left.
    fn score(&self, cleaned: &mut Cleaned, latest: &Evidence, stage: Stage) {
        let left = cleaned.scores.iter_mut().zip(&cleaned.removals).enumerate();
        for (i, (score, _)) in left.filter(|(_, (_, removal))| removal.is_none()) {
            *score = self.rule.score(latest, i, stage);
        }
    }

    /// Removes what floats, and looks again.
    fn remove_floaters(
        &self,
        cleaned: &mut Cleaned,
        latest: &mut Evidence,
        listed: &Listing,
        stage: Stage,
    ) -> Result<()> {
        let Stage { strength, threshold, .. } = stage;
        for _ in 0..self.rule.rounds {
            check(self.monitor)?;
            let (mut count, look) = (0, cleaned.looks);
            for (removal, &score) in cleaned.removals.iter_mut().zip(&cleaned.scores) {
                if removal.is_none() && score > threshold {
                    *removal = Some(Removal { reason: Reason::Floating, strength, score, look });
                    count += 1;
                }
            }
            if count == 0 {
                break;
            }
            let kept: Vec<bool> = cleaned.removals.iter().map(Option::is_none).collect();
            *latest = Evidence::of(&listed.views, listed.parts, &kept);
            cleaned.looks += 1;
            self.score(cleaned, latest, stage);
        }
        Ok(())
    }
}

/// The parts of a model, and what pixels show of them.
pub(crate) struct Listing<'a> {
    pub views: Vec<ListedView>,
    pub parts: Parts<'a>,
    /// `[n]`, or empty if no part is transparent by itself.
    pub opacities: Vec<f32>,
    /// `[n]`: whether a part that the listed views do not show may be shown, or is not to go.
    pub may_be_shown: Vec<bool>,
}
