//! One scene: trained, judged by everything, cleaned up.

use std::path::Path;

use glam::DVec3;
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::evaluate::{CleanUp, DepthError, Evaluator, Measure, Reading, Score, THRESHOLDS, TrueView, clean_up};
use octobayes::field::RadianceField;
use octobayes::metrics::ErrorKind;
use octobayes::monitor::Silent;
use octobayes::render::{RayAverage, Tracer};
use octobayes::uncertainty::UncertaintyField;
use serde::{Deserialize, Serialize};

use crate::common::clock::{Clock, Time};
use crate::common::work::{Dated, keep, kept};
use crate::data::Dataset;
use crate::model::{self, Spent, Training};
use crate::picture;
use crate::plan::{AVERAGES, COVARIANCES, Plan, Scene};

/// Which question a measure belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kind {
    /// A reading at the default level and λ; the variant is the ray average.
    RayAverage,
    /// The variant is the level; averaged as `spread`.
    Level,
    /// The variant is the factor of λ; averaged as `spread`.
    Lambda,
    /// Without a Hessian, one model.
    Baseline,
    /// Several models.
    Ensemble,
}

/// How well one measure ranks the error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    pub kind: Kind,
    /// Covariance, or the baseline's name.
    pub name: String,
    pub variant: String,
    /// AUSE over all pixels together.
    pub mae: f64,
    pub rmse: f64,
    /// Mean over views of their AUSE (MAE).
    pub per_view: f64,
}

/// What the parts took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    pub training: Option<Training>,
    pub estimation: Spent,
    /// Bytes of the model.
    pub model_bytes: usize,
    /// Of rendering the judged views once, without any uncertainty.
    pub rendering: Time,
    /// More than that, with one reading of U.
    pub reading: Time,
    /// Of training all members of the ensemble, the judged one included.
    pub ensemble: Option<Time>,
}

/// Everything that is known about a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneResult {
    pub name: String,
    pub slug: String,
    pub model: String,
    pub views: usize,
    pub test_views: usize,
    pub psnr_test: f64,
    pub depth: DepthError,
    /// Pixels left out, as the model shows nothing there.
    pub empty: usize,
    pub entries: Vec<Entry>,
    pub clean_up: Vec<CleanUpRow>,
    pub costs: Costs,
}

/// A [`CleanUp`] as JSON can hold it: NaN is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CleanUpRow {
    pub threshold: Option<f64>,
    pub psnr: f64,
    pub psnr_shown: Option<f64>,
    pub ssim: f64,
    pub ssimulacra2: f64,
    pub coverage: f64,
}

impl From<CleanUp> for CleanUpRow {
    fn from(c: CleanUp) -> Self {
        let psnr_shown = c.psnr_shown.is_finite().then_some(c.psnr_shown);
        let CleanUp { threshold, psnr, ssim, ssimulacra2, coverage, .. } = c;
        Self { threshold, psnr, psnr_shown, ssim, ssimulacra2, coverage }
    }
}

impl SceneResult {
    /// The entry of a measure, if it was judged.
    pub fn entry(&self, kind: Kind, name: &str, variant: &str) -> Option<&Entry> {
        self.entries.iter().find(|e| e.kind == kind && e.name == name && e.variant == variant)
    }
}

/// The scene's result: the kept one, or a new one unless it `is_late`.
pub fn result(scene: &Scene, plan: &Plan, work: &Path, is_late: bool) -> Result<Option<Dated<SceneResult>>> {
    let folder = model::folder(work, &scene.slug())?;
    let file = folder.join(if scene.ensemble { "result-ensemble.json" } else { "result.json" });
    let key = serde_json::json!([env!("CARGO_PKG_VERSION"), scene, plan]);
    if let Some(result) = kept(&file, &key) {
        return Ok(Some(result));
    }
    if is_late {
        return Ok(None);
    }
    eprintln!("{}", scene.name);
    let result = Dated::make(|| compute(scene, plan, work, &folder))?;
    eprintln!("  done in {:.0} s, {:.0} s of processors", result.time.wall, result.time.cpu);
    keep(&file, &key, &result)?;
    Ok(Some(result))
}

/// What judged measures are, in order.
struct Label {
    kind: Kind,
    name: String,
    variant: String,
}

fn label(kind: Kind, name: &str, variant: impl Into<String>) -> Label {
    Label { kind, name: name.into(), variant: variant.into() }
}

/// All readings, with the labels of their ray averages.
fn readings(base: &UncertaintyField, plan: &Plan, others: &[UncertaintyField]) -> Result<(Vec<Reading>, Vec<Label>)> {
    let (mut readings, mut labels) = (Vec::new(), Vec::new());
    let lambda = base.protocol().lambda / plan.lambdas.iter().copied().fold(1.0, f64::min);
    let mut add = |field: UncertaintyField, averages: &[RayAverage]| {
        let name = field.protocol().covariance.name().into();
        readings.push(Reading { name, field, averages: averages.to_vec() });
    };
    for covariance in COVARIANCES {
        // The first keeps its sums, for the number of rays.
        let field = base.clone().with_lambda(lambda)?.with_covariance(covariance)?;
        add(if covariance == COVARIANCES[0] { field } else { field.without_sums() }, &AVERAGES);
        labels.extend(AVERAGES.iter().map(|a| label(Kind::RayAverage, covariance.name(), a.name())));
    }
    for other in others {
        for covariance in COVARIANCES {
            add(other.clone().with_covariance(covariance)?.without_sums(), &[RayAverage::Spread]);
            labels.push(label(Kind::Level, covariance.name(), other.lattice().level().to_string()));
        }
    }
    for factor in &plan.lambdas {
        for covariance in COVARIANCES {
            let field =
                base.clone().with_lambda((factor * lambda).max(base.protocol().lambda))?.with_covariance(covariance)?;
            add(field.without_sums(), &[RayAverage::Spread]);
            labels.push(label(Kind::Lambda, covariance.name(), format!("{factor:e}")));
        }
    }
    Ok((readings, labels))
}

/// Every k-th of some things, at most `most` of them, spread evenly.
fn spread<T>(all: &[T], most: usize) -> Vec<&T> {
    let n = all.len().min(most).max(1);
    (0..n).filter_map(|i| all.get((2 * i + 1) * all.len() / (2 * n))).collect()
}

fn compute(scene: &Scene, plan: &Plan, work: &Path, folder: &Path) -> Result<SceneResult> {
    let data = Dataset::open(scene, plan, work)?;
    let (field, training) = model::judged(scene, plan, &data, work)?;
    let (mut members, mut ensemble) = (Vec::new(), None);
    if scene.ensemble {
        let mut time = Time::default();
        for seed in 0..plan.members {
            let (member, training) = model::hash_grid(scene, plan, &data, folder, seed)?;
            time = time + training.time;
            members.push(member);
        }
        ensemble = Some(time);
    }
    let about = serde_json::json!([
        Scene { ensemble: false, ..scene.clone() },
        plan.steps,
        plan.log2_hashmap_size,
        plan.resolution,
        plan.baked
    ]);
    let cameras = data.cameras();
    let smallest = plan.lambdas.iter().copied().fold(1.0, f64::min);
    let mut wanted = vec![(plan.level, smallest)];
    wanted.extend(plan.other_levels.iter().map(|&level| (level, 1.0)));
    let mut fields = model::uncertainties(plan, &wanted, &*field, &cameras, folder, &about)?;
    let (base, estimation) = fields.remove(0);
    let others: Vec<UncertaintyField> = fields.into_iter().map(|(field, _)| field).collect();
    let (readings, mut labels) = readings(&base, plan, &others)?;
    drop((base, others));

    let settings = RaySettings::default().cutoff(1e-4);
    let tracer = |field| settings.tracer(field, 0.0, &Silent);
    let members = members.iter().map(|m| tracer(m as &dyn RadianceField)).collect::<Result<_>>()?;
    let evaluator = Evaluator { members, ..Evaluator::new(tracer(&*field)?, &readings) };
    let frames = spread(&data.test, plan.judged_views);
    let stride = (frames[0].camera.resolution[0] / plan.judged).max(1);
    let truths = frames
        .iter()
        .map(|frame| TrueView::read(frame, Some(&data.depth), DVec3::ONE, field.pixel_offset(), stride))
        .collect::<Result<Vec<_>>>()?;
    eprintln!("  judging {} views of {:?} pixels", truths.len(), truths[0].camera.resolution);
    let [rendering, reading] = costs(&evaluator.tracer, &readings[0], &truths)?;
    let views =
        (0..).zip(&truths).map(|(seed, truth)| evaluator.evaluate(truth, seed, &Silent)).collect::<Result<Vec<_>>>()?;

    labels.extend(evaluator.measures().into_iter().filter_map(|measure| match measure {
        Measure::Baseline(b) if b.is_single_model() => Some(label(Kind::Baseline, b.name(), "")),
        Measure::Baseline(b) => Some(label(Kind::Ensemble, b.name(), "")),
        _ => None,
    }));
    let scores: Vec<Score> =
        (0..labels.len()).map(|m| Score::new(&views, m).expect("pixels with depth and some error")).collect();
    let entries: Vec<Entry> = labels
        .into_iter()
        .zip(&scores)
        .map(|(label, score)| Entry {
            kind: label.kind,
            name: label.name,
            variant: label.variant,
            mae: score.area(ErrorKind::Mae),
            rmse: score.area(ErrorKind::Rmse),
            per_view: score.per_view_mean[0],
        })
        .collect();
    picture::curves(&folder.join("sparsification.svg"), scene.name, &entries, &scores)?;

    eprintln!("  clean-up");
    let some: Vec<TrueView> = spread(&truths, plan.cleaned_views).into_iter().cloned().collect();
    let cleaned = clean_up(&evaluator.tracer, &evaluator.baked[0], &some, &THRESHOLDS, &Silent)?;
    if scene.data.may_be_pictured() {
        picture::cleaned(&folder.join("clean-up.png"), scene.data, &some, &cleaned)?;
    }
    Ok(SceneResult {
        name: scene.name.into(),
        slug: scene.slug(),
        model: field.describe(),
        views: data.train.len(),
        test_views: views.len(),
        psnr_test: views.iter().map(|v| v.psnr).sum::<f64>() / views.len() as f64,
        depth: DepthError::new(&views).expect("pixels with depth"),
        empty: views.iter().map(|v| v.empty).sum(),
        entries,
        clean_up: cleaned.into_iter().map(|(c, _)| c.into()).collect(),
        costs: Costs { training, estimation, model_bytes: field.memory(), rendering, reading, ensemble },
    })
}

/// Time to render all views alone, and what one reading adds, from the first two views.
fn costs(tracer: &Tracer, reading: &Reading, truths: &[TrueView]) -> Result<[Time; 2]> {
    let few = &truths[..truths.len().min(2)];
    let one = [Reading { averages: vec![RayAverage::Spread], ..reading.clone() }];
    let time = |readings: &[Reading]| -> Result<Time> {
        let evaluator = Evaluator::new(tracer.clone(), readings);
        let clock = Clock::start();
        for truth in few {
            evaluator.evaluate(truth, 0, &Silent)?;
        }
        let share = truths.len() as f64 / few.len() as f64;
        let Time { cpu, wall } = clock.elapsed();
        Ok(Time { cpu: share * cpu, wall: share * wall })
    };
    let (plain, with) = (time(&[])?, time(&one)?);
    Ok([plain, Time { cpu: (with.cpu - plain.cpu).max(0.0), wall: (with.wall - plain.wall).max(0.0) }])
}
