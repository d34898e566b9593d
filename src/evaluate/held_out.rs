//! A model on held-out frames, and whether their depth maps can be what they are taken for.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::{DepthError, DepthMeaning, EvaluatedView, Evaluator, TrueView};
use crate::dataset::{DepthKind, DepthReadings, Frame};
use crate::field::RadianceField;
use crate::geometry::Domain;
use crate::metrics::quantile;
use crate::monitor::Monitor;
use crate::render::RenderedView;
use crate::{Error, Result};

/// What else may be wrong if depths are.
const CAUSES: &str = "likely causes: --depth-encoding, --z-depth, or units of the cameras";

/// Held-out frames, and how they are looked at.
#[derive(Debug, Clone)]
pub struct HeldOut<'a> {
    /// The frames, with images and, if depth is judged, depth maps.
    pub frames: &'a [Frame],
    /// How depth maps are read; `None` if depth is not judged.
    pub depth: Option<DepthMeaning>,
    /// Colour behind images with alpha.
    pub background: DVec3,
    /// Position in a pixel that its ray passes through, 0 to 1 along x and y.
    pub pixel_offset: f64,
    /// Every so many pixels along x and y are looked at.
    pub stride: u32,
}

/// What an evaluator found on held-out frames.
#[derive(Debug, Clone)]
pub struct Judged {
    /// One per frame, without the rendered views, which are large.
    pub views: Vec<EvaluatedView>,
    /// What the depth maps hold at opaque pixels.
    pub readings: DepthReadings,
    /// `[n]`: the absolute errors if the maps hold the other kind of depth.
    otherwise: Vec<f64>,
    kind: DepthKind,
    source: PathBuf,
}

/// How depths fit the depth maps.
#[derive(Debug, Clone)]
pub struct DepthFit {
    /// The error of depth.
    pub error: DepthError,
    /// What ought to be known of the maps, in sentences.
    pub notes: Vec<String>,
    /// What is probably wrong with them, in sentences.
    pub warnings: Vec<String>,
}

impl HeldOut<'_> {
    /// Evaluates all frames; a stage of its own for the monitor. `seen` gets what the cameras should see. `source` is
    /// the folder or file of the depth maps, for messages.
    ///
    /// # Errors
    /// Those of [`TrueView::read`], and [`Error::Interrupted`].
    pub fn evaluate(
        &self,
        evaluator: &Evaluator,
        source: &Path,
        monitor: &dyn Monitor,
        mut seen: impl FnMut(TrueView),
    ) -> Result<Judged> {
        let kind = self.depth.map(|depth| depth.encoding.kind).unwrap_or_default();
        let mut judged = Judged {
            views: Vec::new(),
            readings: DepthReadings::default(),
            otherwise: Vec::new(),
            kind,
            source: source.into(),
        };
        let rows = self.frames.iter().map(|frame| u64::from(frame.camera.resolution[1].div_ceil(self.stride)));
        monitor.begin("rows", rows.sum::<u64>() * (1 + evaluator.members.len() as u64));
        for (seed, frame) in (0..).zip(self.frames) {
            let truth = TrueView::read(frame, self.depth.as_ref(), self.background, self.pixel_offset, self.stride)?;
            let view = evaluator.evaluate(&truth, seed, monitor)?;
            let other = truth.distance_if_not(kind);
            let error = |&i: &usize| Some((view.rendered.pixels[i].median_depth - other[i]?).abs());
            judged.otherwise.extend(view.pixels.iter().filter_map(error));
            judged.readings += truth.readings;
            judged.views.push(EvaluatedView { rendered: RenderedView::default(), ..view });
            seen(truth);
        }
        monitor.end();
        Ok(judged)
    }
}

impl Judged {
    /// The error of depth, and what is odd about the maps.
    ///
    /// # Errors
    /// If nearly no pixel of the depth maps holds a measurement, or if no error of this model explains half of them.
    pub fn depth(&self, model: &dyn RadianceField) -> Result<DepthFit> {
        if self.readings.are_nearly_all_unmeasured() {
            let expected = format!("depths of what the model shows in at least 1 % of the opaque pixels; {CAUSES}");
            return Err(Error::malformed(&self.source, "depth maps", expected, self.readings.to_string()));
        }
        let error = DepthError::new(&self.views).ok_or_else(|| self.too_few("pixels with depth"))?;
        let unmeasured = (self.readings.measured < self.readings.total()).then(|| self.readings.to_string());
        let notes = unmeasured.into_iter().chain(self.fits_otherwise(&error)).collect();
        let warnings = check_depth(&self.source, &error, model)?.into_iter().collect();
        Ok(DepthFit { error, notes, warnings })
    }

    /// The error that there are too few pixels of known depth.
    #[must_use]
    pub fn too_few(&self, expected: &str) -> Error {
        let pixels: usize = self.views.iter().map(|view| view.pixels.len()).sum();
        let mut found = format!("{pixels} pixels of {} views", self.views.len());
        if self.readings.measured < self.readings.total() {
            found += &format!("; {}", self.readings);
        }
        Error::malformed(&self.source, "depth maps", expected, found)
    }

    /// Whether the depth maps fit much better when read as the other kind of depth.
    fn fits_otherwise(&self, depth: &DepthError) -> Option<String> {
        let mut otherwise = self.otherwise.clone();
        otherwise.sort_unstable_by(f64::total_cmp);
        let (found, other) = (depth.median, quantile(&otherwise, 0.5));
        let (kind, flag) = match self.kind {
            DepthKind::Z => ("distance from the camera", "without --z-depth"),
            DepthKind::Euclidean => ("depth along the viewing axis", "with --z-depth"),
        };
        (other < 0.5 * found).then(|| {
            format!(
                "half of the depths are off by more than {found:.4} scene units; if the maps hold {kind} \
                 ({flag}), by more than {other:.4}"
            )
        })
    }
}

/// Refuses depths that no error of a model explains. Warns of those that hardly any does.
///
/// Models trained from five views are off by a hundredth of their box in the median, a wrong encoding by the
/// distance of the cameras.
fn check_depth(source: &Path, depth: &DepthError, model: &dyn RadianceField) -> Result<Option<String>> {
    let widest = model.bounds().longest_edge();
    let size = match model.natural_domain() {
        Domain::Box(bounds) => bounds.longest_edge(),
        Domain::Contracted { radius, .. } => 2.0 * radius,
    };
    let found = format!("half of the depths are off by more than {:.4} scene units", depth.median);
    if depth.median > widest {
        let expected = format!("depths within the model's box, {widest:.4} across; {CAUSES}");
        return Err(Error::malformed(source, "depth maps", expected, found));
    }
    let is_large = depth.median > 0.1 * size;
    Ok(is_large.then(|| format!("{found}, and the model is {size:.4} across; {CAUSES}")))
}
