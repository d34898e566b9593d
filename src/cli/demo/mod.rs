//! `demo`: the whole line on a built-in scene, for people who have nothing yet.

mod subject;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use glam::Vec3;

use self::subject::{COURTYARD, Subject};
use super::panels::{Ranges, depth_range, view_panels};
use super::progress::Bars;
use super::report;
use crate::dataset::write_transforms;
use crate::estimate::{FieldBuilder, GridKind, GridSettings, Provenance, RaySettings};
use crate::field::{RadianceField, VoxelGrid};
use crate::geometry::{Camera, Domain};
use crate::monitor::Monitor;
use crate::picture::{Panel, write_sheet};
use crate::posterior::{Share, Tally};
use crate::render::{Blend, Probe, RenderedView, render_view};
use crate::uncertainty::{ThresholdedField, UncertaintyField, compare};
use crate::{Error, Result};

/// log10 U above which the demo's clean-up removes density: between the courtyard's surfaces and the floater.
const THRESHOLD: f64 = 3.9;
/// log10 U on the demo's colour bars: from the best seen surface to the prior of level 7, rounded.
const SHOWN: [f64; 2] = [2.0, 6.0];
/// Decades below the prior where the colour bars of other scenes begin, and where their clean-up ends.
const OTHERS: [f64; 2] = [4.0, 1.0];
/// Grid points per axis of the baked scene.
const BAKED: usize = 97;

/// Try everything on a built-in scene: a courtyard that no camera saw from behind, with a fuzzy floater
///
/// Computes the uncertainty on an octree and on the dense grid from the same ray samples, compares memory, time and values, and
/// writes pictures, the fields, the cameras and the scene baked into a voxel grid: input for every other verb.
///
/// With --scene, does so on another scene. Some are hard, each in one way: for these it prints what is to be expected beside what was measured.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for the results
    #[arg(long, value_name = "DIR", default_value = "octobayes-demo")]
    out: PathBuf,

    /// Scene, `list` for all names. `scene:NAME` is a model for the other verbs too
    #[arg(long, value_name = "NAME", default_value = COURTYARD)]
    scene: String,

    /// Finest level, 4 to 9 [default: 7; that of a hard scene is its own]
    #[arg(long, value_parser = clap::value_parser!(u8).range(4..=9))]
    level: Option<u8>,

    /// Rays
    #[arg(long, default_value_t = 200_000, value_parser = clap::value_parser!(u64).range(1000..))]
    rays: u64,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        if self.scene == "list" {
            return say!("{}", subject::list());
        }
        let subject = subject::subject(&self.scene)?;
        std::fs::create_dir_all(&self.out).map_err(Error::io(&self.out, "cannot create the folder"))?;
        let side = if subject.hard.is_none() && !self.scene.starts_with("city") { " from one side only" } else { "" };
        say!("scene: {}, seen by {} cameras{side}", subject.field.describe(), subject.cameras.len())?;
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
        dense.clone().without_evidence().write(&self.out.join("dense.oct"))?;
        let named: Vec<(String, Camera)> =
            subject.cameras.iter().enumerate().map(|(i, camera)| (format!("train/r_{i}"), *camera)).collect();
        write_transforms(&self.out.join("transforms.json"), &named)?;
        if self.scene == COURTYARD {
            VoxelGrid::bake(subject.field.as_ref(), [BAKED; 3], Vec3::Z).write(&self.out.join("courtyard.npz"))?;
        }
        self.suggest()
    }

    /// What was written, and what to try with it.
    fn suggest(&self) -> Result<()> {
        let (out, scene) = (self.out.display(), &self.scene);
        // The courtyard shows that any NeRF can be baked; a broken field cannot.
        let (model, baked) = match self.scene == COURTYARD {
            true => (format!("{out}/courtyard.npz"), ", courtyard.npz"),
            false => (format!("scene:{scene}"), ""),
        };
        say!("written to {out}: demo.png (look at it first), field.oct, dense.oct{baked}, transforms.json")?;
        say!("now try, for example")?;
        say!("  octobayes info {out}/field.oct")?;
        let cameras = format!("--cameras {out}/transforms.json");
        say!("  octobayes uncertainty {model} {cameras} --level 6 --rays 50000 -o {out}/baked.oct")?;
        say!("  octobayes render {model} {out}/baked.oct {cameras} --frame 0 -o {out}/view.png")
    }

    /// Octree and dense field from the same samples, and a table of what they cost.
    fn both_fields(&self, subject: &Subject, bars: &Bars) -> Result<[UncertaintyField; 2]> {
        let (scene, level) = (subject.field.as_ref(), self.level.unwrap_or(subject.level));
        let kinds = [GridKind::Octree, GridKind::Dense];
        let settings = |grid| GridSettings { grid, level, surface_points: 200_000, ..GridSettings::default() };
        let [mut octree, mut dense] = [
            FieldBuilder::new(settings(kinds[0]), Domain::Box(scene.bounds()))?,
            FieldBuilder::new(settings(kinds[1]), Domain::Box(scene.bounds()))?,
        ];
        let rays = RaySettings { rays: self.rays, ..RaySettings::default() };
        let stream = rays.stream(scene, &subject.cameras, &settings(kinds[0]), octree.lattice(), bars)?;
        let mut spent = [Duration::ZERO; 2];
        let start = Instant::now();
        let tally = stream.run(Share::whole(self.rays), Tally::default(), bars, |batches, _| {
            for (spent, builder) in spent.iter_mut().zip([&mut octree, &mut dense]) {
                let start = Instant::now();
                builder.add(batches);
                *spent += start.elapsed();
            }
            Ok(())
        })?;
        let rays_alone = start.elapsed() - spent[0] - spent[1];
        let sums_bytes = [octree.memory(), dense.memory()];
        let provenance = Provenance {
            source: format!("scene:{}", subject.name),
            tally,
            share: Some(Share::whole(self.rays)),
            stream: Some(&stream),
        };
        let mut fields = Vec::new();
        for (spent, builder) in spent.iter_mut().zip([octree, dense]) {
            let start = Instant::now();
            fields.push(builder.finish(&provenance));
            *spent += start.elapsed();
        }

        say!(
            "{} samples of {} rays in {:.1} s, shared by both grids",
            tally.samples,
            tally.rays,
            rays_alone.as_secs_f64()
        )?;
        say!("grid        vertices   field for queries     sums while running   time to sum")?;
        for (((kind, field), bytes), spent) in kinds.iter().zip(&fields).zip(sums_bytes).zip(spent) {
            let [field_bytes, sums] = [field.query_memory(), bytes].map(report::bytes);
            let (name, vertices) = (format!("{kind:?}").to_lowercase(), field.deviations().len());
            say!("{name:<8} {vertices:>11}   {field_bytes:>17}   {sums:>20}   {:>9.2} s", spent.as_secs_f64())?;
        }
        let [octree, dense] = [fields.swap_remove(0), fields.swap_remove(0)];
        let share = octree.deviations().len() as f64 / dense.deviations().len() as f64;
        say!("{:.1} % of the dense grid's vertices; {}", 100.0 * share, report::summary(&octree.summary()))?;
        Ok([octree, dense])
    }

    /// The scene from two sides, whole and cleaned.
    fn pictures(&self, subject: &Subject, field: &UncertaintyField, bars: &Bars) -> Result<()> {
        let scene = subject.field.as_ref();
        let prior = field.prior().log10();
        let (shown, threshold) = match self.scene == COURTYARD {
            true => (SHOWN, THRESHOLD),
            false => ([prior - OTHERS[0], prior], prior - OTHERS[1]),
        };
        let cleaned = ThresholdedField { field: scene, uncertainty: field, threshold };
        let log10 = |x| field.log10(x);
        let probes = [Probe { log10: &log10, blend: Blend::Hit }];
        let sides = subject.views();
        let versions: [(&dyn RadianceField, String); 2] =
            [(scene, String::new()), (&cleaned, format!(", U <= 10^{threshold:.1}"))];
        let mut views: Vec<(String, RenderedView)> = Vec::new();
        for (field, suffix) in &versions {
            let settings = RaySettings { cutoff: 1e-4, ..RaySettings::default() };
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
