//! What is stored of a model and its uncertainty at the samples of a lattice, one byte a channel.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::color::MeanColor;
use super::fit::{Fit, deeper, first_of_faces};
use super::grid::{COARSE, Grid, SAMPLES, SIDE, neighbours, place, sample};
use super::march::Volume;
use super::opacity::fitted;
use super::pack::Pages;
use super::seen::{Marks, SeenRay};
use octobayes::Result;
use octobayes::field::RadianceField;
use octobayes::monitor::{Monitor, check};
use octobayes::render::Occupancy;
use octobayes::uncertainty::{BakedField, Observability, UncertaintyField};

/// Matter that absorbs less than this along the edge of a cell is left out, if a whole brick holds no more.
const MIN_ABSORBED_SHARE: f64 = 2e-4;
/// Codes of log10 U run from 1 at the lower end to this at the prior.
pub const PRIOR: f64 = 254.0;
/// The code of what no training ray reached. U is the prior's there.
pub const UNSEEN: u8 = 255;
/// The code of log10 U as it is seen where nothing sees it: it is as at the point.
pub const AS_AT_POINT: u8 = 0;
/// The code of the most rays. Few codes compress well; a few thousand rays are right within 15 %.
pub const RAYS: f64 = 31.0;
/// The share of a cell's edge by which the points lie apart over which density is averaged.
const POINT_DISTANCE: f64 = 0.2;
/// Where they lie around a sample, in these shares: corners of a cube of which each edge has one.
const TETRAHEDRON: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
/// Steps of the codes of log10 U: as it is seen, at a point, and at a point that is not seen. Few codes compress well.
const STEPS: [u8; 3] = [1, 3, 9];
/// Steps of the codes of matter: that is seen, and that is not.
const FINE: f32 = 3.0;
const ROUGH: u8 = 17;
/// Factors of density that are tried. The mean of what is absorbed in a cell is less than what its mean density
/// absorbs, so that surfaces seem to lie deeper than they do.
const FACTORS: [f64; 8] = [1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0];

/// A brick with matter.
pub struct Brick {
    /// `[SAMPLES]`, x fastest: 255 √α, where α is what is absorbed along the edge of a cell.
    pub matter: Vec<u8>,
    /// `[SAMPLES]`: red, green and blue.
    pub color: Vec<[u8; 3]>,
    /// `[SAMPLES]`: mean of log10 U along rays, so that rays through the volume show what `render` shows; from 1 at the
    /// lower end to [`PRIOR`], or [`AS_AT_POINT`].
    pub seen: Vec<u8>,
    /// `[SAMPLES]`: log10 U at the sample, from 1 at the lower end to [`PRIOR`]; or [`UNSEEN`].
    pub log10: Vec<u8>,
    /// `[COARSE]`: [`RAYS`] log2(1 + rays) / log2(1 + the most), at every other sample.
    pub rays: Vec<u8>,
}

/// How values become codes.
#[derive(Debug, Clone, Copy)]
pub struct Codes {
    /// log10 U of code 1.
    pub low: f64,
    /// log10 U of code [`PRIOR`].
    pub prior: f64,
    /// log2(1 + rays) of code [`RAYS`].
    pub rays: f64,
    /// Factor of density.
    pub density: f64,
}

/// What is to be shown.
pub struct Source<'a> {
    pub model: &'a dyn RadianceField,
    pub field: &'a UncertaintyField,
    /// The same, baked.
    pub baked: &'a BakedField<'a>,
    /// Tells where the model may have density.
    pub occupancy: &'a Occupancy,
    /// Positions of cameras, over whose directions colours are averaged.
    pub eyes: &'a [Vec3],
    /// What cameras see, and what they would see if the slider had removed some of it.
    pub rays: [&'a [SeenRay]; 2],
}

/// A brick that is not coded yet.
struct Matter {
    index: [u32; 3],
    alpha: Vec<f32>,
    is_marked: Vec<bool>,
    color: Vec<[u8; 3]>,
    /// `None` where no interpolation reads it.
    found: Vec<Option<Known>>,
}

/// Values of the field at a sample.
#[derive(Clone, Copy)]
struct Known {
    log10: f32,
    rays: f32,
    is_unseen: bool,
}

/// Samples a model and its field on a lattice; the bricks with matter, in their order in the pages.
///
/// # Errors
/// [`octobayes::Error::Interrupted`] only.
pub fn bricks(grid: &Grid, source: &Source, monitor: &dyn Monitor) -> Result<(Pages, Vec<Brick>, Codes)> {
    let marks = [Marks::new(grid, source.rays[0]), Marks::new(grid, source.rays[1])];
    let all = grid.all_bricks();
    monitor.begin("bricks", all.len() as u64);
    let found: Vec<Option<Matter>> = all
        .into_par_iter()
        .map(|index| {
            check(monitor)?;
            monitor.advance(1);
            Ok(matter(grid, index, source, &marks))
        })
        .collect::<Result<_>>()?;
    monitor.end();
    let found: Vec<Matter> = found.into_iter().flatten().collect();
    let places: Vec<[u32; 3]> = found.iter().map(|brick| brick.index).collect();
    let pages = Pages::new(grid, &places);
    let behind = |x: Vec3| source.baked.log10(x);
    let (density, depths) = unbiased(grid, &pages, &found, source.rays[0]);
    let ids = first_of_faces(&places);
    let matter = coded(&fitted(depths, (grid, &pages), &ids, source.rays, behind));
    let fit = Fit::new(&Volume { grid, pages: &pages, matter: &matter }, ids, source.rays[0]);
    let codes = Codes::of(&found, source.field, density);
    let coded = found
        .into_par_iter()
        .zip(matter.par_chunks(SAMPLES))
        .enumerate()
        .map(|(slot, (brick, matter))| codes.code(brick, matter, |i| fit.at(slot * SAMPLES + i)))
        .collect();
    Ok((pages, coded, codes))
}

/// A brick; `None` without matter.
fn matter(grid: &Grid, index: [u32; 3], source: &Source, marks: &[Marks; 2]) -> Option<Matter> {
    let positions: Vec<Option<Vec3>> = (0..SAMPLES).map(|i| grid.position(sample(index, i))).collect();
    if !may_hold(grid, &positions, source.occupancy) {
        return None;
    }
    let is_marked: Vec<bool> = (0..SAMPLES).map(|i| marks.iter().any(|marks| marks.has(sample(index, i)))).collect();
    let alpha = absorbed(grid, index, &positions, &is_marked, source.model);
    if alpha.iter().all(|a| *a < MIN_ABSORBED_SHARE) {
        return None;
    }
    let color = MeanColor { model: source.model, eyes: source.eyes }.of_brick(&positions, &alpha, &is_marked);
    let is_asked = |i: usize| alpha[i] > 0.0 || neighbours(i).any(|j| alpha[j] > 0.0);
    let known = |x: Vec3| {
        let found = source.baked.query(x);
        let is_unseen = source.field.observability(x, found.uncertainty) == Some(Observability::Unseen);
        Known { log10: found.uncertainty.log10() as f32, rays: found.rays.unwrap_or(0.0) as f32, is_unseen }
    };
    let found = (0..SAMPLES).map(|i| positions[i].filter(|_| is_asked(i)).map(known)).collect();
    Some(Matter { index, alpha: alpha.into_iter().map(|a| a as f32).collect(), is_marked, color, found })
}

/// The factor of density with which the volume's surfaces are as deep as those that are seen, and optical depths along
/// the edges of cells.
fn unbiased(grid: &Grid, pages: &Pages, bricks: &[Matter], rays: &[SeenRay]) -> (f64, Vec<f32>) {
    let depths = |factor: f64| -> Vec<f32> {
        let depth = |a: &f32| -(factor as f32) * (-*a).ln_1p();
        bricks.par_iter().flat_map_iter(|brick| brick.alpha.iter().map(depth)).collect()
    };
    let mut best: Option<(f64, f64)> = None;
    for factor in FACTORS {
        let matter = coded(&depths(factor));
        let off = deeper(&Volume { grid, pages, matter: &matter }, rays);
        if best.is_none_or(|(least, _)| off.abs() < least) {
            best = Some((off.abs(), factor));
        }
        // More density only brings surfaces nearer.
        if off <= 0.0 {
            break;
        }
    }
    let (_, factor) = best.expect("factors to try");
    (factor, depths(factor))
}

/// Codes of matter with these optical depths along the edges of cells.
pub fn coded(depths: &[f32]) -> Vec<u8> {
    let absorbed = |depth: &f32| (-(-*depth).exp_m1()).max(0.0);
    depths.par_iter().map(|depth| (FINE * (255.0 / FINE * absorbed(depth).sqrt()).round()) as u8).collect()
}

/// False if the model has no density at the samples of a brick, nor in the cells of the occupancy grid around them.
fn may_hold(grid: &Grid, positions: &[Option<Vec3>], occupancy: &Occupancy) -> bool {
    let holds = |x: &Vec3| {
        !grid.is_plain(*x) || f64::from(occupancy.majorant(x.as_dvec3())) * grid.edge >= 0.1 * MIN_ABSORBED_SHARE
    };
    positions.iter().flatten().any(holds)
}

/// What is absorbed along the edge of a cell at the samples of a brick: averaged over four points around those that
/// are marked.
fn absorbed(
    grid: &Grid,
    index: [u32; 3],
    positions: &[Option<Vec3>],
    is_marked: &[bool],
    model: &dyn RadianceField,
) -> Vec<f64> {
    let corners = TETRAHEDRON.map(|corner| POINT_DISTANCE * DVec3::from(corner));
    let share = 1.0 / corners.len() as f64;
    let mut points = Vec::with_capacity(corners.len() * SAMPLES);
    for (i, x) in positions.iter().enumerate() {
        match *x {
            Some(_) if is_marked[i] => {
                let at = sample(index, i);
                points.extend(corners.iter().filter_map(|corner| Some((i, share, grid.position(at + *corner)?))));
            }
            Some(x) => points.push((i, 1.0, x)),
            None => {}
        }
    }
    let mut densities = vec![0.0; points.len()];
    model.densities(&points.iter().map(|(_, _, x)| *x).collect::<Vec<_>>(), &mut densities);
    let mut alpha = vec![0.0; SAMPLES];
    for ((i, share, x), sigma) in points.into_iter().zip(densities) {
        // What is not finite is left out, as rays through it are.
        if sigma > 0.0 && sigma.is_finite() {
            alpha[i] -= share * (-f64::from(sigma) * grid.length(x)).exp_m1();
        }
    }
    alpha
}

impl Codes {
    /// That hold the values of all samples.
    fn of(bricks: &[Matter], field: &UncertaintyField, density: f64) -> Self {
        let all = || bricks.iter().flat_map(|brick| brick.found.iter().flatten());
        let prior = field.prior().log10();
        let low = all().map(|known| f64::from(known.log10)).fold(prior - 1.0, f64::min);
        let rays = all().map(|known| f64::from(known.rays)).fold(1.0, f64::max);
        Self { low, prior, rays: (1.0 + rays).log2(), density }
    }

    fn log10(&self, log10: f32) -> u8 {
        let share = ((f64::from(log10) - self.low) / (self.prior - self.low)).clamp(0.0, 1.0);
        (1.0 + (PRIOR - 1.0) * share).round() as u8
    }

    fn code(&self, brick: Matter, matter: &[u8], fitted: impl Fn(usize) -> Option<f32>) -> Brick {
        let Matter { is_marked, color, found, .. } = brick;
        let (mut seen, mut log10) = (vec![AS_AT_POINT; SAMPLES], vec![AS_AT_POINT; SAMPLES]);
        let mut matter = matter.to_vec();
        let rounded = |code: u8, step: u8| (f64::from(code) / f64::from(step)).round() as u8 * step;
        let log10_code = |log10: f32, step: u8| (1 + rounded(self.log10(log10) - 1, step)).min(PRIOR as u8);
        for i in 0..SAMPLES {
            if let Some(known) = found[i] {
                let step = if is_marked[i] { STEPS[1] } else { STEPS[2] };
                log10[i] = if known.is_unseen { UNSEEN } else { log10_code(known.log10, step) };
            }
            if !is_marked[i] {
                matter[i] = rounded(matter[i], ROUGH);
            }
            if let Some(u) = fitted(i) {
                seen[i] = log10_code(u, STEPS[0]);
            }
        }
        let at_coarse = |i: &usize| place(*i).iter().all(|k| k % 2 == 0);
        let rays = |i: usize| {
            (RAYS * (1.0 + found[i].map_or(0.0, |known| f64::from(known.rays))).log2() / self.rays).round() as u8
        };
        let rays: Vec<u8> = (0..SAMPLES).filter(at_coarse).map(rays).collect();
        debug_assert_eq!((rays.len(), SIDE % 2), (COARSE, 0));
        Brick { matter, color, seen, log10, rays }
    }
}
