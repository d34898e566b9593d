//! Rays drawn where vertices have few: what it could gain at most, and what it gains.
//!
//! The error of a point seen by n rays is about c / √n. Draw rays of pixel x in proportion to r(x): a point that a
//! share p of all pixels sees is then seen by p r N rays. Errors are averaged over what cameras see, so over pixels; E
//! is that mean. The least E[(p r)^-½] with E[r] = 1 has r ∝ p^-⅓. It is E[p^-⅓]^{3/2}, where rays drawn evenly have
//! E[p^-½].

use std::collections::HashMap;

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::{FieldBuilder, FieldSource, GridKind, GridSettings, RaySettings};
use octobayes::geometry::{Camera, Domain, Lattice, Mask};
use octobayes::metrics::quantile;
use octobayes::monitor::Silent;
use octobayes::rays::{Pixels, RunProgress, Shard};
use octobayes::render::{GradientMethod, RaySamples};
use octobayes::uncertainty::UncertaintyField;

use super::measure::{Row, Rows, Run, SEEDS, grid, reference, run};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread, whole};
use common::work::Work;

/// Rays are counted in cells of this level: a quarter of the rays has some in each.
const LEVEL: u8 = 5;
/// Side of the squares of pixels that are drawn equally often.
const TILE: u32 = 20;
/// Groups of such squares, by how often they are drawn.
const GROUPS: usize = 9;
/// What a square is drawn for in which the pilot met nothing, relative to the mean.
const NOTHING: f64 = 0.1;
/// The part of the rays that is drawn evenly, to see where few rays get.
const PILOT: u64 = 4;
/// Rays whose errors, drawn evenly, are compared with.
const EVEN: [u64; 5] = [51_200, 102_400, 204_800, 409_600, 819_200];
/// Rays that are allocated.
const ALLOCATED: [u64; 2] = [102_400, 204_800];
/// r ∝ p to these powers; 0 draws evenly what meets matter.
const POWERS: [(&str, f64); 3] = [("0", 0.0), ("−⅓", -1.0 / 3.0), ("−⅔", -2.0 / 3.0)];

/// The table of what could be gained, and that of what was.
pub fn allocation(work: &Work, scenes: &[Scene], of_reference: u64) -> Result<(String, String)> {
    let mut bounds = Table::new(&["scene", "rays at a surface point: 5 %", "50 %", "95 %", "least error, even = 1"]);
    let head = ["scene", "rays", "r ∝ p to the", "samples", "error on surfaces", "even = 1, for as many samples"];
    let mut gains = Table::new(&head);
    for scene in scenes {
        let reference = reference(work, scene, of_reference)?;
        let mut rays = surface_counts(&reference);
        rays.sort_by(f64::total_cmp);
        let of = |power: f64| mean(&rays.iter().map(|n| n.powf(power)).collect::<Vec<f64>>());
        let least = of(-1.0 / 3.0).powf(1.5) / of(-0.5);
        let quantiles = [0.05, 0.5, 0.95].map(|share| whole(quantile(&rays, share)));
        bounds.row(&[&[scene.name.to_string()][..], &quantiles, &[format!("{least:.2}")]].concat());
        let grid = grid(GridKind::Octree, 8);
        let rows = |count: u64, power: Option<f64>| {
            let of = |&seed: &u64| {
                work.row((scene.name, count, power.map(|p| p.to_string()), seed), || {
                    let rays = scene.settings.gradient(GradientMethod::Auto).rays(count).seed(seed);
                    let run = match power {
                        None => run(scene, &rays, &grid)?,
                        Some(power) => allocated(scene, &rays, &grid, power)?,
                    };
                    Row::new(&run, Some(&reference))
                })
            };
            Ok(Rows(SEEDS.iter().map(of).collect::<Result<_>>()?))
        };
        let point = |rows: &Rows| [rows.mean(|row| row.samples), rows.mean(|row| row.surfaces[0])];
        let mut even = Vec::new();
        for count in EVEN {
            even.push(point(&rows(count, None)?));
        }
        for count in ALLOCATED {
            for (name, power) in POWERS {
                let rows = rows(count, Some(power))?;
                let [samples, error] = point(&rows);
                gains.row(&[
                    scene.name.into(),
                    whole(count as f64),
                    name.into(),
                    whole(samples),
                    spread(&rows.all(|row| row.surfaces[0]), 3),
                    format!("{:.2}", error / interpolated(&even, samples)),
                ]);
            }
        }
    }
    let settings = scenes[0].settings.gradient(GradientMethod::Auto);
    let described = describe(&settings, &grid(GridKind::Octree, 8), &["rays", "occupancy"]);
    let words = format!(
        "{described} {} Errors are |Δ log10 U| on surfaces against a dense grid of {} random rays.",
        seeds(&SEEDS),
        whole(of_reference as f64)
    );
    Ok((words, format!("{}\n{}", bounds.text(), gains.text())))
}

/// The number of the dense reference's rays at each of its surface points: at the nearest vertex, where there are any.
fn surface_counts(reference: &UncertaintyField) -> Vec<f64> {
    let lattice = reference.lattice();
    let at = |x: &[f32; 3]| {
        let u = lattice.coordinates(Vec3::from_array(*x))?;
        let nearest = u.round().as_uvec3().to_array();
        Some(reference.rays().get(lattice.dense_index(nearest)) as f64)
    };
    reference.surface().iter().filter_map(at).filter(|&n| n > 0.0).collect()
}

/// The error of rays drawn evenly with so many samples, by straight lines in logarithms.
fn interpolated(even: &[[f64; 2]], samples: f64) -> f64 {
    let last = even.len() - 1;
    let i = even.iter().position(|point| point[0] > samples).unwrap_or(last).clamp(1, last);
    let [[x0, y0], [x1, y1]] = [even[i - 1], even[i]].map(|point| point.map(f64::ln));
    (y0 + (y1 - y0) * (samples.ln() - x0) / (x1 - x0)).exp()
}

/// A run whose rays are drawn in proportion to r; each counts as 1/r, so that sums have the same mean.
fn allocated(scene: &Scene, rays: &RaySettings, grid: &GridSettings, power: f64) -> Result<Run> {
    let domain = Domain::Box(scene.field.bounds());
    let lattice = grid.lattice(domain)?;
    let stream = rays.stream(&scene.field, &scene.cameras, &lattice, &Silent)?;
    let pilot_rays = rays.rays / PILOT;
    let mut pilot = Vec::new();
    stream.run(Shard::whole(pilot_rays), RunProgress::default(), &Silent, |batches, _| {
        pilot.extend_from_slice(batches);
        Ok(())
    })?;
    let tiles = Tiles::new(scene);
    let picks = stream.pixels.picks(0, pilot_rays);
    let tile_of = |ray: u64| {
        let pick = &picks[ray as usize];
        tiles.of(pick.camera, pick.pixel)
    };
    let met = importance(&pilot, &lattice.coarsened(LEVEL), &tiles, tile_of, power);
    let group_of = grouped(&met);
    let nothing = NOTHING * mean(&met.iter().copied().flatten().collect::<Vec<f64>>());
    let importance: Vec<f64> = met.into_iter().map(|met| met.unwrap_or(nothing)).collect();

    // Rays for each group, the pilot's among them.
    let (mut pixels, mut wanted, mut drawn) = ([0.0; GROUPS], [0.0; GROUPS], [0_u64; GROUPS]);
    for (tile, &group) in group_of.iter().enumerate() {
        let size = f64::from(tiles.pixels[tile]);
        pixels[group] += size;
        wanted[group] += size * importance[tile];
    }
    for ray in 0..pilot_rays {
        drawn[group_of[tile_of(ray)]] += 1;
    }
    let (all, whole): (f64, f64) = (pixels.iter().sum(), wanted.iter().sum());
    let mut extra = [0; GROUPS];
    for group in 0..GROUPS {
        let share = (rays.rays as f64 * wanted[group] / whole).round() as u64;
        extra[group] = share.saturating_sub(drawn[group]);
    }
    let total = pilot_rays + extra.iter().sum::<u64>();
    let weight = |group: usize| pixels[group] / all * total as f64 / (drawn[group] + extra[group]).max(1) as f64;

    let mut builder = FieldBuilder::new(*grid, domain)?;
    let mut samples = pilot.iter().map(|batch| batch.positions.len() as u64).sum::<u64>();
    for batch in &mut pilot {
        scale(batch, |ray| weight(group_of[tile_of(ray)]));
    }
    builder.add(&pilot);
    for group in (0..GROUPS).filter(|&group| extra[group] > 0) {
        let stream = stream.with_pixels(Pixels::Sobol, rays.seed * 100 + 1 + group as u64);
        let stream = stream.with_masks(&tiles.masks(scene, |tile| group_of[tile] == group))?;
        stream.run(Shard::whole(extra[group]), RunProgress::default(), &Silent, |batches, _| {
            let mut batches = batches.to_vec();
            for batch in &mut batches {
                samples += batch.positions.len() as u64;
                scale(batch, |_| weight(group));
            }
            builder.add(&batches);
            Ok(())
        })?;
    }
    let progress = RunProgress { rays: total, ..RunProgress::default() };
    let source = FieldSource { progress, stream: Some(&stream), ..FieldSource::default() };
    // The time would mislead: it is mostly that of building masks, which only this experiment needs.
    Ok(Run { field: builder.finish(&source)?.without_sums(), seconds: 0.0, samples })
}

/// Multiplies JᵀJ of each ray.
fn scale(batch: &mut RaySamples, weight: impl Fn(u64) -> f64) {
    for (r, &ray) in batch.rays.iter().enumerate() {
        let root = weight(ray).sqrt() as f32;
        let own = batch.offsets[r]..batch.offsets[r + 1];
        batch.jacobians[own].iter_mut().flatten().for_each(|j| *j *= root);
    }
}

/// Squares of pixels of all cameras.
struct Tiles {
    /// `[cameras + 1]`: the first tile of each.
    starts: Vec<usize>,
    /// `[cameras]`: tiles in a row.
    across: Vec<u32>,
    /// `[tiles]`.
    pixels: Vec<u32>,
}

impl Tiles {
    fn new(scene: &Scene) -> Self {
        let (mut starts, mut across, mut pixels) = (vec![0], Vec::new(), Vec::new());
        for camera in &scene.cameras {
            let [width, height] = camera.resolution;
            across.push(width.div_ceil(TILE));
            for (y, x) in (0..height.div_ceil(TILE)).flat_map(|y| (0..width.div_ceil(TILE)).map(move |x| (y, x))) {
                pixels.push((width - x * TILE).min(TILE) * (height - y * TILE).min(TILE));
            }
            starts.push(pixels.len());
        }
        Self { starts, across, pixels }
    }

    fn of(&self, camera: usize, [column, row]: [u32; 2]) -> usize {
        self.starts[camera] + (row / TILE * self.across[camera] + column / TILE) as usize
    }

    fn masks(&self, scene: &Scene, keeps: impl Fn(usize) -> bool) -> Vec<Option<Mask>> {
        let mask = |(camera, of): (usize, &Camera)| {
            Some(Mask::new(of.resolution, |column, row| keeps(self.of(camera, [column, row]))))
        };
        scene.cameras.iter().enumerate().map(mask).collect()
    }
}

/// `[tiles]`: r, up to a factor; `None` where the pilot met nothing.
fn importance(
    pilot: &[RaySamples],
    cells: &Lattice,
    tiles: &Tiles,
    tile_of: impl Fn(u64) -> usize,
    power: f64,
) -> Vec<Option<f64>> {
    // Where each ray is seen to end.
    let mut ends = Vec::new();
    for batch in pilot {
        for (r, &ray) in batch.rays.iter().enumerate() {
            let own = batch.offsets[r]..batch.offsets[r + 1];
            let end = own.max_by(|&a, &b| batch.weights[a].total_cmp(&batch.weights[b]));
            let cell = end.and_then(|i| cells.coordinates(batch.positions[i])).map(|u| cells.cell(u).0);
            ends.extend(cell.map(|cell| (ray, cell)));
        }
    }
    let mut counts: HashMap<[u32; 3], f64> = HashMap::new();
    for (_, cell) in &ends {
        *counts.entry(*cell).or_default() += 1.0;
    }
    let mut sums = vec![[0.0; 2]; tiles.pixels.len()];
    for (ray, cell) in &ends {
        let [sum, count] = &mut sums[tile_of(*ray)];
        (*sum, *count) = (*sum + counts[cell].powf(power), *count + 1.0);
    }
    sums.iter().map(|[sum, count]| (*count > 0.0).then(|| sum / count)).collect()
}

/// `[tiles]`: the tiles where nothing was met, and groups of equally many of the others by importance.
fn grouped(met: &[Option<f64>]) -> Vec<usize> {
    let mut order: Vec<(f64, usize)> = met.iter().enumerate().filter_map(|(tile, met)| Some(((*met)?, tile))).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut groups = vec![0; met.len()];
    for (rank, (_, tile)) in order.iter().enumerate() {
        groups[*tile] = 1 + rank * (GROUPS - 1) / order.len();
    }
    groups
}
