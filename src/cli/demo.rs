//! `demo`: the whole line on a built-in scene, for people who have nothing yet.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::DVec3;

use super::demo_model::{self, DemoModel};
use super::panels::{Ranges, depth_range, view_panels};
use super::progress::Bars;
use super::report;
use crate::dataset::write_transforms;
use crate::estimate::{FieldBuilder, GridKind, GridSettings, Provenance, RaySettings};
use crate::field::{ClosedForm, HashGrid, RadianceField};
use crate::geometry::{Camera, Domain};
use crate::monitor::Monitor;
use crate::picture::{Panel, write_sheet};
use crate::posterior::{Share, Tally};
use crate::render::{Blend, GradientMethod, Probe, RenderedView, render_view};
use crate::train::Quality;
use crate::uncertainty::{ThresholdedField, UncertaintyField, compare};
use crate::{Error, Result};

/// log10 U above which the demo's clean-up removes density: most of what cameras saw lies below, most of what the model made up above.
const THRESHOLD: f64 = 4.4;
/// log10 U on the demo's colour bars: from the best seen surface to the prior of level 7, rounded.
const SHOWN: [f64; 2] = [2.0, 6.0];
/// Samples along rays are this many times farther apart than the model suggests: a model that was trained for seconds is foggy, and its pictures are small.
const COARSER: f64 = 2.0;
/// Cameras of the demo, all on one side.
const CAMERAS: u32 = 40;

/// Try everything: a NeRF trained on the spot on pictures of a courtyard that no camera saw from behind
///
/// Trains a small hash grid (always the same steps), computes its uncertainty on an octree and on the dense grid from the same ray samples, compares
/// memory, time and values, and writes pictures, the fields, the cameras and the model: input for every other verb.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for the results
    #[arg(long, value_name = "DIR", default_value = "octobayes-demo")]
    out: PathBuf,

    /// Finest level, 4 to 9
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u8).range(4..=9))]
    level: u8,

    /// Rays
    #[arg(long, default_value_t = 40_000, value_parser = clap::value_parser!(u64).range(1000..))]
    rays: u64,
}

impl Args {
    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        std::fs::create_dir_all(&self.out).map_err(Error::io(&self.out, "cannot create the folder"))?;
        let scene = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(CAMERAS, [200, 200]);
        say!("scene: {}, seen by {CAMERAS} cameras from one side only", scene.describe())?;

        let start = Instant::now();
        let DemoModel { field: model, held_out } = demo_model::train(&scene, &cameras, bars)?;
        say!("model: {}, trained on the spot in {:.1} s", model.describe(), start.elapsed().as_secs_f64())?;
        if let Some(Quality { psnr, views, .. }) = held_out {
            say!("  {psnr:.1} dB on {views} held-out pictures of the seen side")?;
        }

        let fields = self.both_fields(&model, &cameras, bars)?;
        let [octree, dense] = &fields;

        let comparison = compare(octree, dense, 200_000, 0)?;
        say!("protocol\n{}\n  threads      {}", report::protocol(octree), rayon::current_num_threads())?;
        say!("{}", report::comparison(&comparison))?;

        self.pictures(&model, octree, &cameras, bars)?;
        self.inputs(&model, &cameras)?;
        octree.write(&self.out.join("field.oct"))?;
        dense.clone().without_evidence().write(&self.out.join("dense.oct"))?;
        let out = self.out.display();
        say!(
            "written to {out}: demo.png (look at it first), field.oct, dense.oct, courtyard.safetensors, transforms.json"
        )?;
        say!("now try, for example")?;
        say!("  octobayes info {out}/field.oct")?;
        say!(
            "  octobayes uncertainty {out}/courtyard.safetensors --cameras {out}/transforms.json --level 6 --rays 50000 -o {out}/baked.oct"
        )?;
        say!(
            "  octobayes render {out}/courtyard.safetensors {out}/baked.oct --cameras {out}/transforms.json --frame 3 -o {out}/view.png"
        )?;
        Ok(())
    }

    /// Octree and dense field from the same samples, and a table of what they cost.
    fn both_fields(&self, scene: &dyn RadianceField, cameras: &[Camera], bars: &Bars) -> Result<[UncertaintyField; 2]> {
        let kinds = [GridKind::Octree, GridKind::Dense];
        let settings =
            |grid| GridSettings { grid, level: self.level, surface_points: 200_000, ..GridSettings::default() };
        let [mut octree, mut dense] = [
            FieldBuilder::new(settings(kinds[0]), Domain::Box(scene.bounds()))?,
            FieldBuilder::new(settings(kinds[1]), Domain::Box(scene.bounds()))?,
        ];
        let march_step = Some(COARSER * scene.suggested_step());
        let gradient = GradientMethod::Auto;
        let rays = RaySettings { rays: self.rays, gradient, march_step, ..RaySettings::default() };
        let stream = rays.stream(scene, cameras, &settings(kinds[0]), octree.lattice(), bars)?;
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
        let provenance =
            Provenance { source: scene.describe(), tally, share: Some(Share::whole(self.rays)), stream: Some(&stream) };
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

    /// The model from the side that was seen and from the side that was not, whole and cleaned.
    fn pictures(
        &self,
        scene: &dyn RadianceField,
        field: &UncertaintyField,
        cameras: &[Camera],
        bars: &Bars,
    ) -> Result<()> {
        let seen = cameras[cameras.len() / 2].resized([180, 180]);
        let target = DVec3::new(0.0, 0.0, -0.25);
        let mirrored = DVec3::new(-seen.position.x, seen.position.y, seen.position.z);
        let unseen = Camera { ..Camera::look_at(mirrored, target, DVec3::Z, 0.8, [180, 180]) };
        let cleaned = ThresholdedField { field: scene, uncertainty: field, threshold: THRESHOLD };
        let log10 = |x| field.log10(x);
        let probes = [Probe { value: &log10, blends: &[Blend::Hit] }];
        let sides = [("seen side", &seen), ("unseen side", &unseen)];
        let versions: [(&dyn RadianceField, String); 2] =
            [(scene, String::new()), (&cleaned, format!(", U <= 10^{THRESHOLD}"))];
        let mut views: Vec<(String, RenderedView)> = Vec::new();
        for (field, suffix) in &versions {
            let march_step = Some(COARSER * field.suggested_step());
            let settings = RaySettings { cutoff: 1e-4, march_step, ..RaySettings::default() };
            let tracer = settings.tracer(*field, 0.0, bars)?;
            bars.begin("rows", 2 * u64::from(seen.resolution[1]));
            for (side, camera) in sides {
                views.push((format!("{side}{suffix}"), render_view(&tracer, camera, 0.5, &probes, bars)?));
            }
            bars.end();
        }
        let ranges = Ranges { depth: depth_range(views.iter().map(|v| &v.1)), log10: SHOWN };
        let rows: Vec<Vec<Panel>> = views.iter().map(|(name, view)| view_panels(view, name, ranges)).collect();
        write_sheet(&self.out.join("demo.png"), &rows)
    }

    /// The model and its cameras as files.
    fn inputs(&self, model: &HashGrid, cameras: &[Camera]) -> Result<()> {
        model.write(&self.out.join("courtyard.safetensors"))?;
        let named: Vec<(String, Camera)> =
            cameras.iter().enumerate().map(|(i, camera)| (format!("train/r_{i}"), *camera)).collect();
        write_transforms(Path::new(&self.out.join("transforms.json")), &named)
    }
}
