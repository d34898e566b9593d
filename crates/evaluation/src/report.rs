//! What an evaluation found, as data: the command line's JSON, and Python's dictionary.

use serde::Serialize;
use serde_json::Value;

use super::{CleanUp, DepthError, EvaluatedView, Evaluation, Evaluator, Interval, Measure, OfKind, Score};
use crate::metrics::{Calibration, Detection};
use octobayes::estimate::facts;
use octobayes::render::RayAverage;
use octobayes::uncertainty::Conformal;
use octobayes_data::{DepthKind, DepthReadings};

/// The figures of an evaluation, and its protocol. Fields are explained where their types are.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// What the figures come to, in sentences: whether U ranks the errors, and whether intervals are right. Empty if
    /// depth was not judged.
    pub verdict: Vec<String>,
    /// Name of the model.
    pub model: String,
    /// The camera file.
    pub cameras: String,
    /// Where the depth maps come from; `None` if depth was not judged.
    pub depth: Option<String>,
    /// Folder of the training views' depth maps.
    pub training_depth: Option<String>,
    /// Folder of the training images that deviations count.
    pub images: Option<String>,
    /// Where masks of the object come from: a folder, or the camera file.
    pub object_masks: Option<String>,
    /// Names of the ensemble's members.
    pub ensemble: Vec<String>,
    /// What depth maps are taken for.
    pub depth_kind: DepthKind,
    /// Every so many pixels along x and y count …
    pub stride: u32,
    /// … if they are these.
    pub mask: &'static str,
    /// How depths are aligned before they are compared.
    pub alignment: &'static str,
    /// Colour behind the scene.
    pub background: [f32; 3],
    /// One per frame.
    pub views: Vec<ViewReport>,
    /// Pixels whose depth is compared.
    pub pixels: usize,
    /// Pixels with a true depth where the model shows nothing.
    pub pixels_without_depth: usize,
    /// What the depth maps hold.
    pub depth_readings: Option<DepthReadings>,
    /// Mean over views, dB.
    pub psnr: f64,
    /// Error of depth.
    pub depth_error: Option<DepthError>,
    /// What is known of the pixels that no training view saw.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub never_seen: Option<NeverSeen>,
    /// Measures by the fields, in the order of [`Evaluator::measures`].
    pub readings: Vec<Scored>,
    /// Measures without a Hessian.
    pub baselines: Vec<Scored>,
    /// All of this for the pixels of one kind, of those that are known.
    pub kinds: Vec<OfKind>,
    /// Which of the readings is the [deviation](Evaluator::deviation) that the verdict is about.
    #[serde(skip)]
    pub deviation: Option<usize>,
    /// What the intervals of calibrated fields hold.
    pub conformal: Vec<Inside>,
    /// The interval that was calibrated on these views.
    pub calibrated: Option<Interval>,
    /// The images after each clean-up, the first without any.
    pub clean_up: Vec<CleanUp>,
}

/// One view.
#[derive(Debug, Clone, Serialize)]
pub struct ViewReport {
    /// The frame's `file_path`.
    pub name: String,
    /// PSNR of the whole image, dB.
    pub psnr: f64,
    /// Pixels whose depth is compared.
    pub pixels: usize,
}

/// The pixels that show what no training view saw.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct NeverSeen {
    /// Number of training views.
    pub training_views: usize,
    /// Share of the pixels; 0 if there are none.
    pub share: f64,
}

/// A measure, and how it did.
#[derive(Debug, Clone, Serialize)]
pub struct Scored {
    /// Its name.
    pub name: String,
    /// How it ranks the errors.
    #[serde(flatten)]
    pub score: Score,
    /// Calibration, if it is a deviation of depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
    /// The same over the pixels whose depth training views confirm, if those are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confirmed: Option<Part>,
    /// How it detects what was never seen, if that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub never_seen: Option<Detection>,
    /// How it is averaged along a ray.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ray_average: Option<RayAverage>,
    /// Record of the field that it is read off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<Value>,
}

/// A part of the pixels.
#[derive(Debug, Clone, Serialize)]
pub struct Part {
    /// Their share of all.
    pub share: f64,
    /// Calibration over them, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
}

/// A calibrated interval, on other views than those that it was made on.
#[derive(Debug, Clone, Serialize)]
pub struct Inside {
    /// Name of the reading.
    pub name: String,
    /// The interval.
    pub interval: Conformal,
    /// Share of the errors that it holds here.
    pub share_inside: f64,
}

impl Report {
    /// The protocol, and what needs no true depth.
    pub(super) fn new(of: &Evaluation, evaluator: &Evaluator, views: &[EvaluatedView]) -> Self {
        let unseen = views.iter().flat_map(|view| &view.never_seen).filter(|unseen| **unseen).count();
        let pixels = views.iter().map(|view| view.pixels.len()).sum();
        let view = |v: &EvaluatedView| ViewReport { name: v.name.clone(), psnr: v.psnr, pixels: v.pixels.len() };
        Self {
            verdict: Vec::new(),
            model: of.name.clone(),
            cameras: of.cameras.to_string_lossy().into(),
            depth: None,
            training_depth: of.training_depth.as_ref().map(|folder| folder.to_string_lossy().into()),
            images: of.images.as_ref().map(|folder| folder.to_string_lossy().into()),
            object_masks: None,
            ensemble: of.ensemble.iter().map(|(name, _)| name.clone()).collect(),
            depth_kind: of.depth.kind,
            stride: of.stride,
            mask: "alpha 255 and known depth",
            alignment: "none",
            background: of.settings.background.to_array(),
            views: views.iter().map(view).collect(),
            pixels,
            pixels_without_depth: views.iter().map(|view| view.empty).sum(),
            depth_readings: None,
            psnr: views.iter().map(|view| view.psnr).sum::<f64>() / views.len() as f64,
            depth_error: None,
            never_seen: evaluator.truly_seen.map(|training| NeverSeen {
                training_views: training.len(),
                share: unseen as f64 / pixels.max(1) as f64,
            }),
            readings: Vec::new(),
            baselines: Vec::new(),
            kinds: Vec::new(),
            deviation: None,
            conformal: Vec::new(),
            calibrated: None,
            clean_up: Vec::new(),
        }
    }

    /// Scores every measure against the depth error; `None` if there is nothing to rank.
    pub(super) fn rank(&mut self, evaluator: &Evaluator, views: &[EvaluatedView]) -> Option<()> {
        for (m, measure) in evaluator.measures().into_iter().enumerate() {
            let (reading, ray_average) = match measure {
                Measure::Reading(r, average) => (Some(&evaluator.readings[r]), Some(average)),
                Measure::DepthDeviation(r) | Measure::DepthDeviationWithImages(r) => {
                    (Some(&evaluator.readings[r]), None)
                }
                Measure::Baseline(_) => (None, None),
            };
            let scored = Scored {
                name: evaluator.name(measure),
                score: Score::new(views, m)?,
                calibration: evaluator.calibration(views, m),
                confirmed: evaluator.calibration_of(views, m, |view| &view.confirmed),
                never_seen: Evaluator::detection(views, m),
                ray_average,
                field: reading.map(|reading| facts(&reading.field)),
            };
            if reading.is_some() { &mut self.readings } else { &mut self.baselines }.push(scored);
            if let (Measure::DepthDeviation(_), Some(reading)) = (measure, reading)
                && let Some(&interval) = reading.field.conformal()
            {
                let held = |v: &EvaluatedView| {
                    v.absolute_error.iter().zip(&v.measures[m]).filter(|(e, s)| **e <= interval.factor * **s).count()
                };
                let share_inside = views.iter().map(held).sum::<usize>() as f64 / self.pixels as f64;
                self.conformal.push(Inside { name: reading.name.clone(), interval, share_inside });
            }
        }
        self.kinds = OfKind::all(evaluator, views);
        self.deviation = evaluator.deviation().map(|(m, _)| m);
        Some(())
    }

    /// All measures, those of the fields first.
    pub fn scored(&self) -> impl Iterator<Item = &Scored> {
        self.readings.iter().chain(&self.baselines)
    }

    /// The measures that are deviations of depth, with their names.
    pub fn calibrated_measures(&self) -> impl Iterator<Item = (&str, &Calibration)> {
        let readings = self.readings.iter().filter_map(|scored| Some((&*scored.name, scored.calibration.as_ref()?)));
        let weights = self.baselines.iter().filter_map(|scored| scored.calibration.as_ref());
        readings.chain(weights.map(|calibration| ("deviation of the ray's weights", calibration)))
    }
}
