//! What a user should know of the candidates for the next photograph: whether their poses follow another convention
//! than those of the training cameras, and which of them add nothing.

use std::path::Path;

use glam::DVec3;

use octobayes::error::printable;
use octobayes::estimate::{Framing, Model, RaySettings};
use octobayes::geometry::Camera;
use octobayes::monitor::Message;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::Views;
use octobayes_evaluation::training_cameras;
use octobayes_next_view::{Blank, Ranking};

use super::{Choices, Purpose, Session};

impl Session {
    /// Sets what a field for the next photograph needs.
    #[must_use]
    pub fn for_next_view(self, noise: Option<f64>) -> Self {
        let choices = Choices { purpose: Some(Purpose::NextView), noise, ..Choices::default() };
        self.rays(RaySettings::default().rays(RAYS).gradient(GradientMethod::Auto)).choices(choices)
    }
}

/// Rays of a field for the next photograph: some dozens for each vertex near to surfaces at its level.
const RAYS: u64 = 200_000;
/// Candidates whose names are listed.
const MAX_NAMES: usize = 3;
/// Cosine between the mean up axes of candidates and of training cameras, below which one of them is upside down.
const UPSIDE_DOWN: f64 = -0.5;

/// Candidates, and what they are ranked for.
pub struct Candidates<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Its name.
    pub model_name: &'a str,
    /// Its uncertainty.
    pub field: &'a UncertaintyField,
    /// The camera file that they are of, if any.
    pub file: Option<&'a Path>,
    /// Their names.
    pub names: &'a [String],
    /// The cameras.
    pub cameras: &'a [Camera],
    /// The training cameras, if they were read.
    pub training: &'a [Camera],
}

impl Candidates<'_> {
    /// Says what is odd about them, given their ranking.
    ///
    /// # Errors
    /// If none of them adds information.
    pub fn remark(&self, ranking: &Ranking, tell: &mut dyn FnMut(Message)) -> Result<()> {
        let (doubt, blanks) = (self.doubt(), self.blanks(ranking));
        if ranking.steps.is_empty() && ranking.complete {
            let cause = doubt.map_or(String::new(), |doubt| format!("; {doubt}"));
            return Err(Error::setting("candidates", format!("views that add something{cause}"), blanks.join("; ")));
        }
        blanks.into_iter().for_each(|text| tell(Message::Note(text)));
        doubt.into_iter().for_each(|text| tell(Message::Warning(text)));
        Ok(())
    }

    /// How many add nothing, for each reason.
    fn blanks(&self, ranking: &Ranking) -> Vec<String> {
        let of = |blank: Blank| {
            let names = self.names.iter().zip(&ranking.blanks).filter(|(_, found)| **found == Some(blank));
            let names: Vec<String> = names.map(|(name, _)| printable(name)).collect();
            let more = if names.len() > MAX_NAMES { ", …" } else { "" };
            let listed = names.iter().take(MAX_NAMES).map(String::as_str).collect::<Vec<_>>().join(", ");
            let (n, all) = (names.len(), self.names.len());
            (n > 0).then(|| format!("{n} of {all} candidates: gain 0, {} ({listed}{more})", blank.words()))
        };
        [Blank::InMatter, Blank::PastTheBox, Blank::MeetsNothing].into_iter().filter_map(of).collect()
    }

    /// Why they may not be the cameras that were meant.
    fn doubt(&self) -> Option<String> {
        let framing = Framing::from_cameras(self.cameras, &self.model.main_box());
        if let Some(causes) = framing.causes() {
            return Some(format!(
                "the candidates see little of the model: {}; likely causes: {causes}",
                framing.measured()
            ));
        }
        let up =
            |cameras: &[Camera]| cameras.iter().map(|camera| camera.axes.y_axis).sum::<DVec3>().normalize_or_zero();
        let cosine = up(self.cameras).dot(up(&self.known_training()));
        (cosine < UPSIDE_DOWN).then(|| {
            "the candidates' up axes point down where those of the training cameras point up; likely cause: OpenCV's \
             camera axes (y down, looking along +z) instead of OpenGL's"
                .into()
        })
    }

    /// The training cameras: those that were read, or that the model stores, or that lie beside the candidates.
    fn known_training(&self) -> Vec<Camera> {
        if !self.training.is_empty() {
            return self.training.to_vec();
        }
        let nowhere = Path::new("");
        let views = self.file.and_then(|file| Views::read(file, None).ok());
        let views = views.unwrap_or_else(|| Views {
            path: nowhere.into(),
            frames: Vec::new(),
            resolution_source: octobayes_data::ResolutionSource::Assumed,
            notes: Vec::new(),
        });
        let wanted = self.field.record().cameras_checksum;
        let found = training_cameras(self.model, self.model_name, wanted, self.file.unwrap_or(nowhere), &views);
        found.into_iter().map(|named| named.camera).collect()
    }
}
