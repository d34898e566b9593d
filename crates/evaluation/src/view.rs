//! A rendered view beside the truth: depth errors and measures of uncertainty for the same pixels.

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::kinds::{Outline, TrueParts};
use super::{Baseline, Measure, Part, PixelKind, Reading, TrueView};
use crate::metrics::{Calibration, Detection, ensemble_variance};
use octobayes::Result;
use octobayes::metrics::psnr;
use octobayes::monitor::{Monitor, check};
use octobayes::render::{MIN_SUPPORTING_RAYS, Probe, RenderedView, Renderer};
use octobayes::uncertainty::BakedField;
use octobayes_depth::{DepthDeviation, Photograph, Sweep, TrainingViews};

/// Bytes that a reading's field may take to answer faster.
const MAX_BAKED_BYTES: usize = 256 << 20;

/// A model to evaluate, and the measures to rank its errors by.
pub struct Evaluator<'a> {
    /// The model.
    pub model: &'a dyn Renderer,
    /// Its uncertainty, read in several ways.
    pub readings: &'a [Reading],
    /// The readings' fields, laid out for speed where that takes little memory.
    pub baked: Vec<BakedField<'a>>,
    /// Other models trained in the same way; may be empty.
    pub members: Vec<&'a dyn Renderer>,
    /// The cameras that the model was trained on, if they are known.
    pub training: Option<&'a TrainingViews>,
    /// Their images, one for each of them, if deviations of depth are to count them, too.
    pub photographs: Option<&'a [Photograph]>,
    /// What those cameras truly saw, if that is known.
    pub truly_seen: Option<&'a TrainingViews>,
}

/// Errors and measures at the pixels of one view that have a true depth.
#[derive(Debug, Clone)]
pub struct EvaluatedView {
    /// The frame's `file_path`.
    pub name: String,
    /// PSNR of the whole image, dB.
    pub psnr: f64,
    /// `[n]`: indices of the pixels in the image.
    pub pixels: Vec<usize>,
    /// `[n]`: |median depth − true distance|, scene units.
    pub absolute_error: Vec<f64>,
    /// `[measures][n]`: larger means more uncertain.
    pub measures: Vec<Vec<f64>>,
    /// `[n]`: [`RenderedView::spread`], scene units.
    pub spread: Vec<f64>,
    /// `[n]`: whether no training camera saw the true surface; empty if that is not known.
    pub never_seen: Vec<bool>,
    /// `[n]`: whether training cameras [confirm](TrainingViews::confirmed) the median depth; empty if they are not
    /// known.
    pub confirmed: Vec<bool>,
    /// `[n]` for every kind that is known: whether the pixel is of it.
    pub kinds: Vec<(PixelKind, Vec<bool>)>,
    /// Standard deviation of the true depths, scene units, if they are known in steps: it counts beside a deviation of
    /// depth where errors are to lie within it.
    pub rounding: f64,
    /// Pixels with a true depth where the model shows nothing. They are left out,
    /// because there is no depth to compare.
    pub empty: usize,
    /// The rendered view, whole.
    pub rendered: RenderedView,
}

impl EvaluatedView {
    /// Deviations of differences to the true depths.
    #[must_use]
    pub fn with_rounding(&self, deviations: &[f64]) -> Vec<f64> {
        deviations.iter().map(|deviation| deviation.hypot(self.rounding)).collect()
    }

    /// `[n]`: whether a pixel is of a kind; `None` if the kind is not known.
    #[must_use]
    pub fn of_kind(&self, kind: PixelKind) -> Option<&[bool]> {
        self.kinds.iter().find(|(known, _)| *known == kind).map(|(_, is)| &is[..])
    }
}

impl<'a> Evaluator<'a> {
    /// Evaluates a model by these readings and by measures of its own rays.
    #[must_use]
    pub fn new(model: &'a dyn Renderer, readings: &'a [Reading]) -> Self {
        let baked = readings.iter().map(|reading| BakedField::within(MAX_BAKED_BYTES, &reading.field)).collect();
        Self { model, readings, baked, members: Vec::new(), training: None, photographs: None, truly_seen: None }
    }

    /// All measures, in the order of [`EvaluatedView::measures`].
    #[must_use]
    pub fn measures(&self) -> Vec<Measure> {
        let readings = self.readings.iter().enumerate();
        let readings = readings.flat_map(|(i, r)| r.averages.iter().map(move |&average| Measure::Reading(i, average)));
        let mut baselines = vec![Baseline::RayVariance, Baseline::Distance];
        if self.counted().is_some() {
            baselines.extend([Baseline::WeightsSpreadPerRootRay, Baseline::WeightsSpreadPerRay]);
        }
        baselines.push(Baseline::Random);
        if !self.members.is_empty() {
            baselines.push(Baseline::EnsembleVariance);
        }
        let alone = self.deviations(None).map(|(i, _)| Measure::DepthDeviation(i));
        let with_images = self.with_images().map(|(i, _)| Measure::DepthDeviationWithImages(i));
        readings.chain(alone).chain(with_images).chain(baselines.into_iter().map(Measure::Baseline)).collect()
    }

    /// Name of a measure in tables.
    #[must_use]
    pub fn name(&self, measure: Measure) -> String {
        match measure {
            Measure::Reading(i, average) if self.readings[i].averages.len() > 1 => {
                format!("{}, {}", self.readings[i].name, average.name())
            }
            Measure::Reading(i, _) => self.readings[i].name.clone(),
            Measure::DepthDeviation(i) => format!("{}, depth deviation", self.readings[i].name),
            Measure::DepthDeviationWithImages(i) => {
                format!("{}, depth deviation with images", self.readings[i].name)
            }
            Measure::Baseline(baseline) => baseline.name().into(),
        }
    }

    /// The measure that stands for deviations of depth, and its reading: with the training images, if they are known,
    /// and of the first field that has one.
    #[must_use]
    pub fn deviation(&self) -> Option<(usize, &Reading)> {
        let (i, measure) = match self.with_images() {
            Some((i, _)) => (i, Measure::DepthDeviationWithImages(i)),
            None => self.deviations(None).next().map(|(i, _)| (i, Measure::DepthDeviation(i)))?,
        };
        let m = self.measures().into_iter().position(|found| found == measure)?;
        Some((m, &self.readings[i]))
    }

    /// The deviations of depth of the readings that have them, by the readings' index.
    fn deviations<'s>(&'s self, sweep: Option<Sweep<'s>>) -> impl Iterator<Item = (usize, DepthDeviation<'s>)> {
        let of = move |(i, field)| Some((i, DepthDeviation::new(field, sweep).ok()?));
        self.baked.iter().enumerate().filter_map(of)
    }

    /// That of the first of them with the training images, if they are known.
    pub(super) fn with_images(&self) -> Option<(usize, DepthDeviation<'_>)> {
        let (photographs, training) = self.photographs.zip(self.training)?;
        self.deviations(Some(Sweep::new(photographs, training))).next()
    }

    /// The first reading whose field stores its ray counts.
    fn counted(&self) -> Option<&Reading> {
        self.readings.iter().find(|reading| !reading.field.rays().is_empty())
    }

    /// Renders a view with the model and all members, and compares. Advances the monitor by one per row of each, and
    /// once more for the training images.
    ///
    /// # Errors
    /// [`octobayes::Error::Interrupted`], or if a model cannot render the camera.
    pub fn evaluate(&self, truth: &TrueView, seed: u64, monitor: &dyn Monitor) -> Result<EvaluatedView> {
        let probed = self.readings.iter().zip(&self.baked);
        let probes: Vec<Probe> = probed.map(|(reading, field)| Probe { field, averages: &reading.averages }).collect();
        check(monitor)?;
        let (camera, offset) = (&truth.camera, truth.pixel_offset);
        let (whole, stride) = (&truth.whole, truth.stride);
        let rendered = self.model.strided_image(whole, stride, offset, &probes, monitor)?;
        let mut members = Vec::new();
        for member in &self.members {
            check(monitor)?;
            members.push(member.strided_image(whole, stride, offset, &[], monitor)?);
        }

        let with_truth = truth.distance.iter().enumerate().filter_map(|(i, d)| Some((i, (*d)?)));
        let shown = |i: usize| rendered.pixels[i].opacity > 0.0;
        let (seen, empty): (Vec<_>, Vec<_>) = with_truth.partition(|(i, _)| shown(*i));
        let pixels: Vec<usize> = seen.iter().map(|(i, _)| *i).collect();
        let width = camera.resolution[0] as usize;
        let at = |i: usize, depth: f64| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + offset);
            camera.ray(x, y).at(depth)
        };
        let rays = |i: usize| {
            let x = at(i, rendered.pixels[i].expected_depth).as_vec3();
            let field = &self.counted().expect("a measure of fields that store their ray counts").field;
            field.support_at(self.model.bounds().clamp(x)).clamp(MIN_SUPPORTING_RAYS, f64::INFINITY)
        };
        let is_unseen = |views: &TrainingViews, i: usize, d: f64| views.sighting(at(i, d)).views == 0;
        let never_seen: Vec<bool> =
            self.truly_seen.iter().flat_map(|views| seen.iter().map(|&(i, d)| is_unseen(views, i, d))).collect();
        let unseen = self.truly_seen.map(|_| &never_seen[..]);
        let kinds = kinds(truth, &seen, unseen, |i| rendered.pixels[i].median_depth);
        let confirmed = self.training.map(|training| training.confirmed(camera, offset, &rendered));
        let confirmed: Vec<bool> = confirmed.iter().flat_map(|all| pixels.iter().map(|&i| all[i])).collect();
        let of_view =
            |(_, deviation): (usize, DepthDeviation)| deviation.of_view(self.model, camera, offset, &rendered, monitor);
        let deviations = self.deviations(None).chain(self.with_images());
        let deviations = deviations.map(of_view).collect::<Result<Vec<_>>>()?;
        let spread = |i: usize| rendered.spread[i];
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut readings = rendered.log10_uncertainty.iter();
        let mut deviations = deviations.iter();
        let mut measure = |measure| -> Vec<f64> {
            let each = |value: &dyn Fn(usize) -> f64| pixels.iter().map(|&i| value(i)).collect();
            match measure {
                Measure::Reading(..) => {
                    let averaged = readings.next().expect("one image per reading and average");
                    each(&|i| averaged[i])
                }
                Measure::DepthDeviation(_) | Measure::DepthDeviationWithImages(_) => {
                    let deviations = deviations.next().expect("one image per deviation");
                    each(&|i| deviations[i])
                }
                Measure::Baseline(baseline) => match baseline {
                    Baseline::RayVariance => each(&|i| rendered.pixels[i].depth_variance),
                    Baseline::Distance => each(&|i| rendered.pixels[i].median_depth),
                    Baseline::WeightsSpreadPerRootRay => each(&|i| spread(i) / rays(i).sqrt()),
                    Baseline::WeightsSpreadPerRay => each(&|i| spread(i) / rays(i)),
                    Baseline::Random => pixels.iter().map(|_| random.random()).collect(),
                    Baseline::EnsembleVariance => each(&|i| {
                        let depth = |m: &RenderedView| self.depth(truth, m, i);
                        ensemble_variance(&members.iter().map(depth).collect::<Vec<_>>())
                    }),
                },
            }
        };
        let measures = self.measures().into_iter().map(&mut measure).collect();
        let colors: Vec<DVec3> = rendered.pixels.iter().map(|p| p.color).collect();
        Ok(EvaluatedView {
            name: truth.name.clone(),
            psnr: psnr(&colors, &truth.colors),
            absolute_error: seen.iter().map(|(i, d)| (rendered.pixels[*i].median_depth - d).abs()).collect(),
            spread: pixels.iter().map(|&i| spread(i)).collect(),
            pixels,
            measures,
            never_seen,
            confirmed,
            kinds,
            rounding: truth.parts.rounding,
            empty: empty.len(),
            rendered,
        })
    }

    /// How well the measure of index `m` detects the pixels that no training camera saw, over all views.
    ///
    /// `None` if that is not known, or if all pixels or none were seen.
    #[must_use]
    pub fn detection(views: &[EvaluatedView], m: usize) -> Option<Detection> {
        let never_seen: Vec<bool> = views.iter().flat_map(|view| &view.never_seen).copied().collect();
        let measure: Vec<f64> = views.iter().flat_map(|view| &view.measures[m]).copied().collect();
        if never_seen.is_empty() { None } else { Detection::new(&measure, &never_seen) }
    }

    /// Calibration over the pixels of all views, if the measure of index `m` is a standard deviation of depth.
    ///
    /// [`Baseline::RayVariance`] stands for [`EvaluatedView::spread`]. `None` for other measures, and if
    /// [`Calibration::new`] has none.
    #[must_use]
    pub fn calibration(&self, views: &[EvaluatedView], m: usize) -> Option<Calibration> {
        let errors: Vec<f64> = views.iter().flat_map(|view| &view.absolute_error).copied().collect();
        Calibration::new(&errors, &self.found_deviations(views, m)?)
    }

    /// The same over the pixels of `part`, such as those whose depth is [confirmed](EvaluatedView::confirmed). `None`
    /// if the measure is no standard deviation of depth, or if the part is not known.
    #[must_use]
    pub fn calibration_of(
        &self,
        views: &[EvaluatedView],
        m: usize,
        part: impl Fn(&EvaluatedView) -> &[bool],
    ) -> Option<Part> {
        let part: Vec<bool> = views.iter().flat_map(part).copied().collect();
        let errors: Vec<f64> = views.iter().flat_map(|view| &view.absolute_error).copied().collect();
        let deviations = self.found_deviations(views, m)?;
        let pairs = errors.into_iter().zip(deviations).zip(&part).filter(|(_, is)| **is).map(|(pair, _)| pair);
        let (errors, deviations): (Vec<f64>, Vec<f64>) = pairs.unzip();
        let share = errors.len() as f64 / part.len() as f64;
        (!part.is_empty()).then(|| Part { share, calibration: Calibration::new(&errors, &deviations) })
    }

    /// The measure of index `m` over the pixels of all views, if it is a standard deviation of depth.
    fn found_deviations(&self, views: &[EvaluatedView], m: usize) -> Option<Vec<f64>> {
        let of_view = |view: &EvaluatedView| -> Option<Vec<f64>> {
            match self.measures()[m] {
                Measure::DepthDeviation(_) | Measure::DepthDeviationWithImages(_) => {
                    Some(view.with_rounding(&view.measures[m]))
                }
                Measure::Baseline(Baseline::RayVariance) => Some(view.with_rounding(&view.spread)),
                _ => None,
            }
        };
        views.iter().map(of_view).collect::<Option<Vec<_>>>().map(|found| found.concat())
    }

    /// Median depth of a member's pixel. Where it shows nothing, the depth at which the ray leaves the box.
    fn depth(&self, truth: &TrueView, member: &RenderedView, i: usize) -> f64 {
        if member.pixels[i].opacity > 0.0 {
            return member.pixels[i].median_depth;
        }
        let width = member.resolution[0] as usize;
        let [x, y] = [i % width, i / width].map(|n| n as f64 + truth.pixel_offset);
        self.model.bounds().clip(&truth.camera.ray(x, y)).map_or(0.0, |(_, exit)| exit)
    }
}

/// The kinds that are known of pixels, given with their true distances.
fn kinds(
    truth: &TrueView,
    seen: &[(usize, f64)],
    never_seen: Option<&[bool]>,
    median: impl Fn(usize) -> f64,
) -> Vec<(PixelKind, Vec<bool>)> {
    let TrueParts { outlines, object, jump, .. } = &truth.parts;
    let mut kinds = Vec::new();
    if !object.is_empty() {
        kinds.push((PixelKind::Object, seen.iter().map(|(i, _)| object[*i]).collect()));
        kinds.push((PixelKind::Around, seen.iter().map(|(i, _)| !object[*i]).collect()));
    }
    if outlines.is_empty() {
        return kinds;
    }
    let of_outline = |is: fn(Outline) -> bool| -> Vec<bool> { seen.iter().map(|(i, _)| is(outlines[*i])).collect() };
    let (silhouette, thin) = (of_outline(|outline| outline.is_silhouette), of_outline(|outline| outline.is_thin));
    let in_front: Vec<bool> = seen.iter().map(|&(i, distance)| median(i) < distance - jump).collect();
    let is_unseen = |k: usize| never_seen.is_some_and(|unseen| unseen[k]);
    let other = (0..seen.len()).map(|k| !(silhouette[k] || thin[k] || in_front[k] || is_unseen(k))).collect();
    kinds.extend([(PixelKind::Silhouette, silhouette), (PixelKind::Thin, thin)]);
    kinds.extend(never_seen.map(|unseen| (PixelKind::NeverSeen, unseen.to_vec())));
    kinds.extend([(PixelKind::InFront, in_front), (PixelKind::Other, other)]);
    kinds
}
