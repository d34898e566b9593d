//! `demo`: the whole pipeline, for users who have no model yet.

mod model;
mod scene;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use self::model::DemoModel;
use self::scene::{DemoScene, Shown};
use super::files::CommandFiles;
use super::options::count;
use super::panels::{Ranges, depth_range, view_panels};
use super::progress::Bars;
use super::report;
use crate::dataset::write_transforms;
use crate::estimate::{Estimation, GridKind, GridSettings, Outcome, RaySettings};
use crate::field::RadianceField;
use crate::geometry::Camera;
use crate::monitor::Monitor;
use crate::picture::{Panel, write_sheet};
use crate::rays::RunProgress;
use crate::render::{GradientMethod, Probe, RayAverage, RenderedView, render_view};
use crate::train::Quality;
use crate::uncertainty::{ThresholdedField, UncertaintyField, compare};
use crate::{Error, Result};

/// File name of the trained model, in the folder of results.
const MODEL: &str = "courtyard.safetensors";

/// Try everything: train a NeRF on pictures of a courtyard that no camera sees from behind
///
/// Trains a small hash grid for a fixed number of steps, and computes its uncertainty on an octree and on the
/// dense grid from the same ray samples. Compares memory, time and values. Writes pictures, the fields, the
/// cameras and the model, which are input for the other verbs.
///
/// With --scene, uses a built-in scene instead of a trained model. Some scenes are hard, each in one way: for
/// these it prints what to expect beside what was measured.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for the results
    #[arg(long, value_name = "DIR", default_value = "octobayes-demo")]
    out: PathBuf,

    /// Built-in scene to use instead of the trained model, or `list` for all names; `scene:NAME` is a model for
    /// the other verbs too
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,

    /// Finest level, 4 to 9 [default: 7; a hard scene has its own]
    #[arg(long, value_parser = clap::value_parser!(u8).range(4..=9))]
    level: Option<u8>,

    /// Rays [default: 40000; 200000 for a built-in scene]
    #[arg(long, value_parser = count::<u64>(1000..))]
    rays: Option<u64>,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        if self.scene.as_deref() == Some("list") {
            return say!("{}", scene::list());
        }
        let named = self.scene.as_deref().map(scene::subject).transpose()?;
        std::fs::create_dir_all(&self.out).map_err(Error::io(&self.out, "cannot create the folder"))?;
        let model = self.scene.is_none().then_some(MODEL);
        let results = ["demo.png", "field.oct", "dense.oct", "transforms.json"].into_iter().chain(model);
        CommandFiles::default().outputs("a file in --out", results.map(|name| self.out.join(name))).check()?;
        let subject = match named {
            Some(subject) => subject,
            None => self.trained(bars)?,
        };
        say!("scene: {}, seen by {} cameras{}", subject.field.describe(), subject.cameras.len(), subject.side)?;
        if let Some(about) = subject.about() {
            say!("{about}")?;
        }

        let fields = self.both_fields(&subject, bars)?;
        let [octree, dense] = &fields;

        let comparison = compare(octree, dense, 200_000, 0)?;
        say!("protocol\n{}\n  threads      {}", report::protocol(octree), rayon::current_num_threads())?;
        say!("{}", report::comparison(&comparison))?;
        if let Some(outcome) = subject.outcome(octree) {
            say!("{outcome}")?;
        }

        self.pictures(&subject, octree, bars)?;
        octree.write(&self.out.join("field.oct"))?;
        dense.clone().without_sums().write(&self.out.join("dense.oct"))?;
        let named: Vec<(String, Camera)> =
            subject.cameras.iter().enumerate().map(|(i, camera)| (format!("train/r_{i}"), *camera)).collect();
        write_transforms(&self.out.join("transforms.json"), &named)?;
        self.suggest()
    }

    /// Trains the model and writes its file.
    fn trained(&self, bars: &Bars) -> Result<DemoScene> {
        let start = Instant::now();
        let (scene, cameras) = scene::courtyard();
        let DemoModel { field, held_out } = model::train(&scene, &cameras, bars)?;
        say!("model: {}, trained on the spot in {:.1} s", field.describe(), start.elapsed().as_secs_f64())?;
        if let Some(Quality { psnr, views, .. }) = held_out {
            say!("  {psnr:.1} dB on {views} held-out pictures of the seen side")?;
        }
        field.write(&self.out.join(MODEL))?;
        Ok(DemoScene::trained(field, cameras))
    }

    /// Prints what was written, and what to try with it.
    fn suggest(&self) -> Result<()> {
        let out = self.out.display();
        let (model, file) = match &self.scene {
            None => (format!("{out}/{MODEL}"), format!(", {MODEL}")),
            Some(scene) => (format!("scene:{scene}"), String::new()),
        };
        say!("written to {out}: demo.png (look at it first), field.oct, dense.oct{file}, transforms.json")?;
        say!("now try, for example")?;
        say!("  octobayes info {out}/field.oct")?;
        // The trained model knows its cameras.
        let cameras = self.scene.as_ref().map_or(String::new(), |_| format!(" --cameras {out}/transforms.json"));
        say!("  octobayes uncertainty {model}{cameras} --level 6 --rays 50000 -o {out}/again.oct")?;
        say!("  octobayes render {model} {out}/again.oct{cameras} --frame 0 -o {out}/view.png")
    }

    /// The octree and the dense field from the same samples. Prints a table of what they cost.
    fn both_fields(&self, subject: &DemoScene, bars: &Bars) -> Result<[UncertaintyField; 2]> {
        let (scene, level) = (subject.field.as_ref(), self.level.unwrap_or(subject.level));
        let kinds = [GridKind::Octree, GridKind::Dense];
        let grids = kinds.map(|grid| GridSettings { grid, level, surface_points: 200_000, ..GridSettings::default() });
        let rays = RaySettings {
            rays: self.rays.unwrap_or(subject.rays),
            gradient: GradientMethod::Auto,
            march_step: Some(subject.coarser * scene.suggested_step()),
            ..RaySettings::default()
        };
        let start = Instant::now();
        let estimation =
            Estimation::new(scene, &subject.cameras).rays(rays).grid(grids[0]).source(&subject.source).monitor(bars);
        let outcomes = estimation.prepare()?.finish_on(&grids)?;
        let rays_alone = start.elapsed() - outcomes.iter().map(|outcome| outcome.summing).sum::<Duration>();
        let RunProgress { rays, samples, .. } = outcomes[0].progress;
        say!("{samples} samples of {rays} rays in {:.1} s, shared by both grids", rays_alone.as_secs_f64())?;
        say!("grid        vertices   field for queries     sums while running   time to sum")?;
        for (kind, Outcome { field, sums_bytes, summing, .. }) in kinds.iter().zip(&outcomes) {
            let [field_bytes, sums] = [field.query_memory(), *sums_bytes].map(report::bytes);
            let (name, vertices) = (format!("{kind:?}").to_lowercase(), field.deviations().len());
            say!("{name:<8} {vertices:>11}   {field_bytes:>17}   {sums:>20}   {:>9.2} s", summing.as_secs_f64())?;
        }
        let mut fields = outcomes.into_iter().map(|outcome| outcome.field);
        let [Some(octree), Some(dense)] = [fields.next(), fields.next()] else {
            unreachable!("one outcome for each grid")
        };
        let share = octree.deviations().len() as f64 / dense.deviations().len() as f64;
        say!("{:.1} % of the dense grid's vertices; {}", 100.0 * share, report::summary(&octree.summary()))?;
        Ok([octree, dense])
    }

    /// Writes pictures of the scene from two sides, whole and cleaned.
    fn pictures(&self, subject: &DemoScene, field: &UncertaintyField, bars: &Bars) -> Result<()> {
        let scene = subject.field.as_ref();
        let Shown { log10: shown, threshold } = subject.shown.unwrap_or_else(|| Shown::below(field.prior().log10()));
        let cleaned = ThresholdedField { field: scene, uncertainty: field, threshold };
        let log10 = |x| field.log10(x);
        let probes = [Probe { value: &log10, blends: &[RayAverage::WeightedMean] }];
        let sides = subject.views();
        let versions: [(&dyn RadianceField, String); 2] = [(scene, String::new()), (&cleaned, ", cleaned".into())];
        say!("rows of demo.png that say \"cleaned\" are without density where log10 U is above {threshold:.1}")?;
        let mut views: Vec<(String, RenderedView)> = Vec::new();
        for (field, suffix) in &versions {
            let march_step = Some(subject.coarser * field.suggested_step());
            let settings = RaySettings { cutoff: 1e-4, march_step, ..RaySettings::default() };
            let tracer = settings.tracer(*field, 0.0, bars)?;
            bars.begin("rows", sides.iter().map(|(_, camera)| u64::from(camera.resolution[1])).sum());
            for (side, camera) in &sides {
                views.push((format!("{side}{suffix}"), render_view(&tracer, camera, 0.5, &probes, bars)?));
            }
            bars.end();
        }
        let ranges = Ranges { depth: depth_range(views.iter().map(|v| &v.1)), log10: shown };
        let rows: Vec<Vec<Panel>> = views.iter().map(|(name, view)| view_panels(view, name, ranges)).collect();
        write_sheet(&self.out.join("demo.png"), &rows)
    }
}
