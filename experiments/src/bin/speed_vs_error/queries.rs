//! Queries of octree and dense grid, and files.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use octobayes::estimate::GridKind;
use octobayes::metrics::median;
use octobayes::monitor::Silent;
use octobayes::render::{GradientMethod, Probe, Probed, ProbedField, RayAverage, render_view};
use octobayes::uncertainty::{BakedField, Estimate, UncertaintyField};
use octobayes::{Error, Result};
use serde::{Deserialize, Serialize};

use super::measure::{self, alternating, grid, run};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

const POINTS: usize = 4_000_000;

/// Every time is the median of these rounds.
const ROUNDS: [u64; 5] = [0, 1, 2, 3, 4];

/// A way to ask for all points.
type Asked<'a> = &'a dyn Fn(&[Vec3]) -> Vec<Estimate>;

/// Nanoseconds per point of each way, medians of rounds.
fn times(points: &[Vec3], ways: [Asked<'_>; 3]) -> Result<[f64; 3]> {
    let mut all = alternating(&ways, &ROUNDS, |ask, _| {
        let start = Instant::now();
        std::hint::black_box(ask(points));
        Ok(Some(start.elapsed().as_secs_f64() * 1e9 / points.len() as f64))
    })?
    .into_iter()
    .map(median);
    Ok(std::array::from_fn(|_| all.next().unwrap_or(f64::NAN)))
}

/// A way to ask for points one by one, on one core.
fn singly(one: impl Fn(Vec3) -> Estimate) -> impl Fn(&[Vec3]) -> Vec<Estimate> {
    move |points| {
        points.iter().for_each(|&x| {
            std::hint::black_box(one(x));
        });
        Vec::new()
    }
}

/// Level of the field that is written and read.
const FILE_LEVEL: u8 = 10;

/// Octree and dense grid with the same values, in the same run.
pub fn queries(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let rays = lego.settings.rays(1_024_000).gradient(GradientMethod::Analytic);
    let mut table = Table::new(&[
        "level",
        "points",
        "octree, ns",
        "baked, ns",
        "dense, ns",
        "dense : octree",
        "dense : baked",
        "single: octree, ns",
        "baked, ns",
        "dense, ns",
    ]);
    let mut memory = Table::new(&["level", "octree, MB", "baked, MB", "dense, MB", "baking, s"]);
    let mut pictures = Table::new(&["level", "none, s", "octree, point by point", "octree", "baked", "dense"]);
    let mut file = None;
    for level in [8, 9, FILE_LEVEL] {
        let row: LevelRow = work.row(("queries", level), || {
            let octree = run(lego, &rays, &grid(GridKind::Octree, level))?.field;
            let octree = lego.with_surfaces(octree, rays, measure::POINTS)?;
            let file = (level == FILE_LEVEL).then(|| files(&octree)).transpose()?;
            Ok(LevelRow { file, ..of_level(lego, &octree)? })
        })?;
        let LevelRow { queries: times, costs, pictures: seconds, file: this } = row;
        file = file.or(this);
        pictures.row(&[&[level.to_string()][..], &seconds.map(|seconds| format!("{seconds:.2}"))].concat());
        for (name, [octree, baked, dense, single @ ..]) in ["anywhere in the box", "on surfaces"].iter().zip(times) {
            let batch = [octree, baked, dense].map(|ns| format!("{ns:.1}"));
            let ratios = [dense / octree, dense / baked].map(|ratio| format!("{ratio:.2}"));
            let single = single.map(whole);
            table.row(&[&[level.to_string(), (*name).into()][..], &batch, &ratios, &single].concat());
        }
        let [megabytes @ .., seconds] = costs;
        let megabytes = megabytes.map(|bytes| format!("{:.1}", bytes / 1e6));
        memory.row(&[&[level.to_string()][..], &megabytes, &[format!("{seconds:.2}")]].concat());
    }
    let [vertices, written, read] = file.unwrap_or_default();
    let words = format!(
        "{}. {} {} {} points in no order, all threads (single queries: one, 200,000 points), medians of 5; the dense \
         grid has the octree's values.",
        lego.name,
        describe(&rays, &grid(GridKind::Octree, 8), &["level"]),
        seeds(&[0]),
        whole(POINTS as f64),
    );
    let [width, height] = lego.cameras[0].resolution;
    let body = format!(
        "{}\n{}\n\
         One picture of {width} x {height} pixels with the mean of log10 U along its rays, medians of 5:\n\n{}\n\
         A field of level {FILE_LEVEL} with {} vertices, without sums: written in {written:.2} s, read in {read:.2} s.",
        table.text(),
        memory.text(),
        pictures.text(),
        whole(vertices)
    );
    Ok((words, body))
}

/// What is measured at one level.
#[derive(Default, Serialize, Deserialize)]
struct LevelRow {
    /// Of points anywhere and on surfaces: nanoseconds of octree, baked octree and dense grid, then of single queries.
    queries: [[f64; 6]; 2],
    /// Bytes of the three, and seconds of baking.
    costs: [f64; 4],
    /// Seconds of a picture without log10 U, and with it in four ways.
    pictures: [f64; 5],
    /// Vertices and seconds of the file.
    file: Option<[f64; 3]>,
}

fn of_level(lego: &Scene, octree: &UncertaintyField) -> Result<LevelRow> {
    let bounds = lego.field.bounds();
    let golden = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
    let at = |i: usize| glam::DVec3::from(golden.map(|g| (i as f64 * g).fract()));
    let anywhere: Vec<Vec3> = (0..POINTS).map(|i| (bounds.min() + at(i) * bounds.size()).as_vec3()).collect();
    let half = (0.5 * octree.lattice().edge()).as_vec3();
    let seen = octree.surface();
    // Around points that the rays saw, up to half a cell off, in no order.
    let surfaces: Vec<Vec3> = (0..POINTS)
        .map(|i| Vec3::from_array(seen[i * 7_919 % seen.len()]) + half * (2.0 * at(i).as_vec3() - 1.0))
        .collect();
    let dense = octree.on_dense_grid();
    let start = Instant::now();
    let baked = BakedField::new(octree);
    let seconds = start.elapsed().as_secs_f64();
    let times_at = |points: &[Vec3]| -> Result<[f64; 6]> {
        let [a, b, c] = times(
            points,
            [&|points| octree.query_all(points), &|points| baked.query_all(points), &|points| dense.query_all(points)],
        )?;
        let [d, e, f] = times(
            &points[..200_000],
            [&singly(|x| octree.query(x)), &singly(|x| baked.query(x)), &singly(|x| dense.query(x))],
        )?;
        Ok([a, b, c, d, e, f])
    };
    let queries = [times_at(&anywhere)?, times_at(&surfaces)?];
    let bytes = [octree.query_memory(), octree.query_memory() + baked.memory(), dense.query_memory()];
    let [a, b, c] = bytes.map(|bytes| bytes as f64);
    let one_by_one = OneByOne(octree);
    let asked: [Option<&dyn ProbedField>; 5] = [None, Some(&one_by_one), Some(octree), Some(&baked), Some(&dense)];
    let seconds_of = alternating(&asked, &ROUNDS, |field, _| picture(lego, *field).map(Some))?;
    let pictures = std::array::from_fn(|i| median(seconds_of[i].clone()));
    Ok(LevelRow { queries, costs: [a, b, c, seconds], pictures, file: None })
}

/// Asked in the plain way, as pictures once did.
struct OneByOne<'a>(&'a UncertaintyField);

impl ProbedField for OneByOne<'_> {
    fn at(&self, points: &[Vec3]) -> Vec<Probed> {
        let probed = |x: &Vec3| Probed { value: self.0.log10(*x), rays: f64::NAN };
        points.iter().map(probed).collect()
    }
}

/// Seconds of a picture of a training camera with the mean of log10 U along its rays.
fn picture(lego: &Scene, field: Option<&dyn ProbedField>) -> Result<f64> {
    let tracer = lego.settings.tracer(&*lego.field, 0.0, &Silent)?;
    let probes: Vec<Probe> =
        field.map(|field| Probe { field, averages: &[RayAverage::WeightedMean] }).into_iter().collect();
    let start = Instant::now();
    std::hint::black_box(render_view(&tracer, &lego.cameras[0], lego.field.pixel_offset(), &probes, &Silent)?);
    Ok(start.elapsed().as_secs_f64())
}

/// Writes and reads a field: its vertices, and seconds.
fn files(field: &UncertaintyField) -> Result<[f64; 3]> {
    let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
    let path = folder.path().join("field.oct");
    let start = Instant::now();
    field.write(&path)?;
    let written = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let read = UncertaintyField::read(&path)?;
    Ok([read.summary().vertices as f64, written, start.elapsed().as_secs_f64()])
}
