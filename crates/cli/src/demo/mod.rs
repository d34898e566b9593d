//! `demo`: the whole pipeline, for users who have no model yet.

mod matter;
mod model;
mod scene;
#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use glam::Vec3;

use self::matter::Shares;
use self::scene::{DemoScene, TOLERANCE};
use super::files::CommandFiles;
use super::options::{MAX_COUNT, UTF_8, count};
use super::panels::{Ranges, depth_range, view_panels};
use super::progress::Bars;
use super::report;
use octobayes::estimate::{Estimation, GridKind, GridSettings, Outcome, RaySettings};
use octobayes::field::TrainedField;
use octobayes::geometry::Camera;
use octobayes::io::AtomicFile;
use octobayes::monitor::Monitor;
use octobayes::rays::RunProgress;
use octobayes::render::{GradientMethod, Probe, RayAverage, RenderedView, render_view};
use octobayes::uncertainty::{BakedField, ThresholdedField, UncertaintyField, compare, unknowns};
use octobayes::{Error, Result};
use octobayes_data::{Frame, write_transforms};
use octobayes_show::picture::{Panel, color_panel, write_noted_sheet, write_sheet};
use octobayes_show::viewer::{Page, VolumeView, write_volume};
use octobayes_train::Quality;

/// File name of the trained model, in the folder of results.
const MODEL: &str = "courtyard.safetensors";

/// The file that marks a folder of a demo.
const MARKER: &str = "demo.json";

/// Cells of the viewer's volume, and the most bytes of its file: it is written in a few seconds.
const CELLS: u32 = 128;
const SIZE: usize = 6_000_000;
/// What stands below the pictures of the trained model.
const HOLLOW: &str = "Cleaned, from behind: where the made-up back was removed, you look into the hollow front, which \
    cameras saw from outside.";
/// Share of the visible surfaces that clean-up keeps. The rest, reached by few rays, leaves small holes.
const KEPT: f64 = 0.99;
/// Share of them whose log10 U lies below the colour bar.
const BELOW_BAR: f64 = 0.01;
/// Least length of the colour bar, decades. It ends at the prior.
const LEAST_BAR: f64 = 1.0;

/// Try everything: train a NeRF on pictures of a courtyard that no camera sees from behind
///
/// Trains a small hash grid for a fixed number of steps, and computes its uncertainty on an octree and on the
/// dense grid from the same ray samples. Compares memory, time and values. Removes what is uncertain from the model,
/// and measures against the true scene what was removed and what was kept. Writes pictures, the fields, the cameras
/// and the model, which are input for the other verbs.
///
/// With --scene, uses a built-in scene instead of a trained model.
///
/// Replaces the results of an earlier demo, whose folder has a file demo.json, and no other files.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for the results
    #[arg(short, long, value_name = "DIR", default_value = "octobayes-demo")]
    output: PathBuf,

    /// Built-in scene to use instead of the trained model: courtyard, ball, slab, wall, floater, city or city-SEED;
    /// `scene:NAME` is a model for the other verbs too
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,

    /// Finest level, 4 to 9
    #[arg(long, default_value_t = 7, value_parser = count::<u8>(4..=9))]
    level: u8,

    /// Rays
    #[arg(long, default_value_t = 200_000, value_parser = count::<u64>(1000..=MAX_COUNT))]
    rays: u64,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        if self.output.to_str().is_none() {
            return Err(Error::setting("--output", UTF_8, self.output.display().to_string()));
        }
        let named = self.scene.as_deref().map(scene::subject).transpose()?;
        std::fs::create_dir_all(&self.output).map_err(Error::io(&self.output, "cannot create the folder"))?;
        let model = self.scene.is_none().then_some(MODEL);
        let results = ["view.html", "demo.png", "field.oct", "dense.oct", "transforms.json"].into_iter().chain(model);
        let files: Vec<PathBuf> = results.chain([MARKER]).map(|name| self.output.join(name)).collect();
        CommandFiles::default().outputs("a file in --output", files.clone()).check()?;
        self.claim(&files)?;
        self.results(named, bars)?;
        self.suggest()
    }

    /// Marks the folder as one of a demo, unless it holds `files` of others.
    fn claim(&self, files: &[PathBuf]) -> Result<()> {
        let marker = self.output.join(MARKER);
        if marker.exists() {
            return Ok(());
        }
        if let Some(other) = files.iter().find(|file| file.exists()) {
            let expected = "nothing, or a folder of an earlier demo";
            return Err(Error::malformed(other, "file in --output", expected, "a file; choose another folder"));
        }
        let mut file = AtomicFile::create(&marker)?;
        writeln!(file, "{{ \"made_by\": \"octobayes demo\" }}").map_err(Error::io(&marker, "cannot write"))?;
        file.commit()
    }

    /// Writes all results, and prints what they are.
    fn results(&self, named: Option<DemoScene>, bars: &Bars) -> Result<()> {
        let subject = match named {
            Some(subject) => subject,
            None => self.trained(bars)?,
        };
        say!("scene: {}, seen by {} cameras", subject.field.describe(), subject.cameras.len())?;

        let fields = self.both_fields(&subject, bars)?;
        let [octree, dense] = &fields;

        let comparison = compare(octree, dense, 200_000, 0)?;
        say!("record\n{}\n  threads      {}", report::record(octree), rayon::current_num_threads())?;
        say!("{}", report::comparison(&comparison))?;

        let shown = Shown::new(octree);
        self.clean(&subject, octree, shown, bars)?;
        self.pictures(&subject, octree, shown, bars)?;
        self.viewer(&subject, octree, shown, bars)?;
        let checksum = octobayes_models::checksum(&self.model_name(), None, None)?;
        for (field, name) in [(octree, "field.oct"), (dense, "dense.oct")] {
            field.clone().for_queries().with_model(checksum).write(&self.output.join(name))?;
        }
        write_transforms(&self.output.join("transforms.json"), &subject.cameras)
    }

    /// Trains the model and writes its file.
    fn trained(&self, bars: &Bars) -> Result<DemoScene> {
        let start = Instant::now();
        let model = model::train(0, bars)?;
        say!("model: {}, trained on the spot in {:.1} s", model.field.describe(), start.elapsed().as_secs_f64())?;
        if let Some(Quality { psnr, views, .. }) = model.held_out {
            say!("  {psnr:.1} dB on {views} held-out pictures of the seen side; no camera saw the other one")?;
        }
        model.field.write(&self.output.join(MODEL))?;
        Ok(DemoScene::trained(model))
    }

    /// The model as other verbs call it.
    fn model_name(&self) -> String {
        match &self.scene {
            None => self.output.join(MODEL).to_string_lossy().into_owned(),
            Some(scene) => format!("scene:{scene}"),
        }
    }

    /// Prints what was written, and what to try with it.
    fn suggest(&self) -> Result<()> {
        let out = self.output.display();
        let model = self.model_name();
        let file = if self.scene.is_none() { format!(", {MODEL}") } else { String::new() };
        say!(
            "written to {out}: view.html (open it in a browser first), demo.png, field.oct, \
             dense.oct{file}, transforms.json"
        )?;
        say!("now try, for example")?;
        say!("  octobayes info {out}/field.oct")?;
        // The trained model stores its cameras, and the noise that makes U a length.
        let cameras = self.scene.as_ref().map_or(String::new(), |_| format!(" --cameras {out}/transforms.json"));
        let scale = if self.scene.is_none() { " --scale data" } else { "" };
        say!("  octobayes uncertainty {model}{cameras}{scale} --level 6 --rays 50000 -o {out}/again.oct")?;
        say!("  octobayes render {model} {out}/again.oct{cameras} --frame 0 -o {out}/view.png")
    }

    /// The octree and the dense field from the same samples. Prints a table of what they cost.
    fn both_fields(&self, subject: &DemoScene, bars: &dyn Monitor) -> Result<[UncertaintyField; 2]> {
        let (scene, level) = (subject.field.as_ref(), self.level);
        let cameras = subject.poses();
        let kinds = [GridKind::Octree, GridKind::Dense];
        let grids = kinds.map(|grid| GridSettings::default().grid(grid).level(level));
        let rays = RaySettings::default().rays(self.rays).gradient(GradientMethod::Auto);
        let start = Instant::now();
        let estimation =
            Estimation::new(&scene, &cameras).rays(rays).grid(grids[0]).source(&subject.source).monitor(bars);
        let outcomes = estimation.prepare()?.finish_on(&grids)?;
        let rays_alone = start.elapsed() - outcomes.iter().map(|outcome| outcome.summing).sum::<Duration>();
        let RunProgress { rays, samples, .. } = outcomes[0].progress;
        say!("{samples} samples of {rays} rays in {:.1} s, shared by both grids", rays_alone.as_secs_f64())?;
        say!("grid        vertices   field for queries     sums while running   time to sum")?;
        for (kind, Outcome { field, sums_bytes, summing, .. }) in kinds.iter().zip(&outcomes) {
            let [field_bytes, sums] = [field.query_memory(), *sums_bytes].map(report::bytes);
            let (name, vertices) = (kind.name(), field.deviations().len());
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

    /// Prints what clean-up does and, for the trained model, what it did by the truth.
    fn clean(&self, subject: &DemoScene, uncertainty: &UncertaintyField, shown: Shown, bars: &Bars) -> Result<()> {
        let Shown { threshold, .. } = shown;
        let share = format!("which {:.0}% of the visible surfaces do not exceed", 100.0 * KEPT);
        say!("clean-up: no density where log10 U is above {threshold:.3}, {share}")?;
        let Some(truth) = &subject.truth else { return Ok(()) };
        let unbaked = BakedField::unbaked(uncertainty);
        let model = ThresholdedField::new(subject.field.as_ref(), &unbaked, threshold);
        let Shares { made_up_seen, made_up_behind, removed, kept } = Shares::measure(&model, truth, bars)?;
        let [seen, behind, removed, kept] = [made_up_seen, made_up_behind, removed, kept].map(|share| 100.0 * share);
        say!("by the truth, the scene that the pictures show")?;
        say!("  made up: {seen:.2} % of what the seen side shows, {behind:.1} % of what is visible from behind")?;
        say!("  removed: {removed:.1} % of what is made up behind")?;
        say!("  kept:    {kept:.1} % of the true surface that held-out cameras see")?;
        say!("  (made up: with nothing true within {TOLERANCE} scene units along each axis)")
    }

    /// Writes the viewer.
    fn viewer(&self, subject: &DemoScene, field: &UncertaintyField, shown: Shown, bars: &Bars) -> Result<()> {
        let model = subject.field.as_ref();
        let tracer = RaySettings::for_images().tracer(model, 0.0, bars)?;
        let frame = |(name, camera): &(String, Camera)| Frame::new(*camera, name, "");
        let frames: Vec<Frame> = subject.cameras.iter().map(frame).collect();
        let surface: Vec<Vec3> = field.surface().iter().copied().map(Vec3::from_array).collect();
        let page = Page {
            field,
            frames: &frames,
            planned: &[],
            offset: 0.5,
            background: tracer.background,
            surface: &surface,
            range: [shown.low, field.prior().log10()],
            title: &format!("the demo's {}", self.scene.as_deref().unwrap_or("courtyard")),
            unit: (1.0, "scene units"),
        };
        let view = VolumeView { model, tracer: &tracer, page };
        write_volume(&self.output.join("view.html"), &view, CELLS, SIZE, bars).map(|_| ())
    }

    /// Writes pictures of the scene from two sides: the truth or the depth, the model, log10 U, the model cleaned.
    fn pictures(&self, subject: &DemoScene, uncertainty: &UncertaintyField, shown: Shown, bars: &Bars) -> Result<()> {
        let Shown { low, threshold } = shown;
        let (field, prior) = (subject.field.as_ref(), uncertainty.prior().log10());
        let unbaked = BakedField::unbaked(uncertainty);
        let cleaned = ThresholdedField::new(field, &unbaked, threshold);
        let truth = subject.truth.as_ref().map(|truth| &truth.scene as &dyn TrainedField);
        let probes = [Probe { field: uncertainty, averages: &[RayAverage::WeightedMean] }];
        let render = |field: &dyn TrainedField| -> Result<Vec<RenderedView>> {
            let tracer = RaySettings::default().cutoff(1e-4).tracer(field, 0.0, bars)?;
            let cameras = subject.views().map(|view| view.1);
            bars.begin("rows", cameras.iter().map(|camera| u64::from(camera.resolution[1])).sum());
            let views = cameras.iter().map(|camera| render_view(&tracer, camera, 0.5, &probes, bars)).collect();
            bars.end();
            views
        };
        let (views, cleaned) = (render(field)?, render(&cleaned)?);
        let truths = truth.map(render).transpose()?;
        let quantity = uncertainty.record().scale.quantity();
        let (depth, error) = (depth_range(&views), [0.0, 1.0]);
        let ranges = Ranges { depth, error, conformal: None, log10: [low, prior], prior, quantity };
        let colors = |title: &str, view: &RenderedView| {
            color_panel(title, view.resolution, view.pixels.iter().map(|pixel| pixel.color))
        };
        let rows: Vec<Vec<Panel>> = (0..views.len())
            .map(|i| {
                let (name, camera) = subject.views()[i];
                let unknown = unknowns(&unbaked, &camera, 0.5, &views[i]);
                let mut row = view_panels(&views[i], None, name, ranges, &unknown);
                if let Some(truths) = &truths {
                    row.remove(1);
                    row.insert(0, colors(&format!("{}: truth", subject.views()[i].0), &truths[i]));
                    row[1].title = "model".into();
                }
                row.push(colors(&format!("cleaned: log10 U ≤ {threshold:.2}"), &cleaned[i]));
                row
            })
            .collect();
        let path = self.output.join("demo.png");
        if truth.is_some() { write_noted_sheet(&path, &rows, HOLLOW) } else { write_sheet(&path, &rows) }
    }
}

/// How U is shown.
#[derive(Clone, Copy)]
struct Shown {
    /// Lower end of the colour bar, log10 U.
    low: f64,
    /// log10 U above which clean-up removes density.
    threshold: f64,
}

impl Shown {
    /// By shares of the visible surfaces. If the cameras see nothing, there is nothing to remove.
    fn new(uncertainty: &UncertaintyField) -> Self {
        let prior = uncertainty.prior().log10();
        let [low, threshold] = uncertainty.surface_quantiles([BELOW_BAR, KEPT]).unwrap_or([prior; 2]);
        Self { low: low.min(prior - LEAST_BAR), threshold }
    }
}
