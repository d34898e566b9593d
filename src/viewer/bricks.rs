//! What is stored of a model and its uncertainty at the samples of a lattice, one byte a channel.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::color::{MeanColor, outwards, spread};
use super::grid::{Grid, SAMPLES, neighbours, sample};
use crate::Result;
use crate::field::RadianceField;
use crate::geometry::Camera;
use crate::monitor::{Monitor, check};
use crate::render::Occupancy;
use crate::uncertainty::{Knowledge, UncertaintyField};

/// Matter that absorbs less than this along the edge of a cell is left out, if a whole brick holds no more.
const LEAST: f64 = 2e-4;
/// Codes of log10 U run from 0 at the lower end to this at the prior.
pub const PRIOR: f64 = 254.0;
/// The code of what no training ray reached. U is the prior's there.
pub const UNSEEN: u8 = 255;
/// How far rays across a surface reach to both sides of a sample, cells, and at how many places they ask.
const ACROSS: f64 = 1.5;
const PLACES: u32 = 9;
/// Places that contribute less to such a ray are not asked about U.
const FAINT: f64 = 0.03;
/// The share of a cell's edge by which the points lie apart over which density is averaged.
const APART: f64 = 0.25;

/// A brick with matter; all arrays are `[SAMPLES]`, x fastest.
pub struct Brick {
    /// Among the lattice's bricks.
    pub index: [u32; 3],
    /// 255 √α, where α is what is absorbed along the edge of a cell.
    pub matter: Vec<u8>,
    /// Red, green and blue.
    pub color: Vec<[u8; 3]>,
    /// log10 U, from 0 at the lower end to [`PRIOR`]; or [`UNSEEN`].
    pub log10: Vec<u8>,
    /// [`RAYS`] log2(1 + rays) / log2(1 + the most).
    pub rays: Vec<u8>,
}

/// The code of the most rays. Few codes compress well; a few thousand rays are right within 15 %.
pub const RAYS: f64 = 31.0;

/// How values become codes.
#[derive(Debug, Clone, Copy)]
pub struct Codes {
    /// log10 U of code 0.
    pub low: f64,
    /// log10 U of code [`PRIOR`].
    pub prior: f64,
    /// log2(1 + rays) of code [`RAYS`].
    pub rays: f64,
}

/// A brick whose uncertainty is not coded yet.
struct Matter {
    index: [u32; 3],
    matter: Vec<u8>,
    color: Vec<[u8; 3]>,
    /// `None` where no interpolation asks.
    found: Vec<Option<Known>>,
}

/// What the field says of the matter at a sample.
#[derive(Clone, Copy, Default)]
struct Known {
    log10: f64,
    rays: f64,
    is_unseen: bool,
}

/// Samples `model` and `field` on a lattice; `occupancy` tells where the model may have density. Colours are means over
/// the directions from which `cameras` look.
///
/// # Errors
/// [`crate::Error::Interrupted`] only.
pub fn bricks(
    grid: &Grid,
    model: &dyn RadianceField,
    occupancy: &Occupancy,
    field: &UncertaintyField,
    cameras: &[Camera],
    monitor: &dyn Monitor,
) -> Result<(Vec<Brick>, Codes)> {
    let eyes = spread(cameras);
    let all = grid.all_bricks();
    monitor.begin("bricks", all.len() as u64);
    let found: Vec<Option<Matter>> = all
        .into_par_iter()
        .map(|index| {
            check(monitor)?;
            monitor.advance(1);
            let positions: Vec<Option<Vec3>> = (0..SAMPLES).map(|i| grid.position(sample(index, i))).collect();
            if !may_hold(grid, &positions, occupancy) {
                return Ok(None);
            }
            let (alpha, middles) = absorbed(grid, index, &positions, model);
            if alpha.iter().all(|a| *a < LEAST) {
                return Ok(None);
            }
            let color = MeanColor { model, eyes: &eyes }.of_brick(&positions, &alpha);
            let matter: Vec<u8> = alpha.iter().map(|a| (255.0 * a.sqrt()).round() as u8).collect();
            let found = knowledge((grid, index), model, field, (&alpha, &matter), &middles);
            Ok(Some(Matter { index, matter, color, found }))
        })
        .collect::<Result<_>>()?;
    monitor.end();
    let found: Vec<Matter> = found.into_iter().flatten().collect();
    let codes = Codes::of(&found, field);
    Ok((found.into_iter().map(|brick| codes.code(brick)).collect(), codes))
}

/// False if the model has no density at the samples of a brick, nor in the cells of the occupancy grid around them.
fn may_hold(grid: &Grid, positions: &[Option<Vec3>], occupancy: &Occupancy) -> bool {
    let holds = |x: &Vec3| !grid.is_plain(*x) || f64::from(occupancy.majorant(x.as_dvec3())) * grid.edge >= 0.1 * LEAST;
    positions.iter().flatten().any(holds)
}

/// What is absorbed along the edge of a cell at the samples of a brick, averaged over eight points around each, and the
/// middle of what absorbs there.
fn absorbed(
    grid: &Grid,
    index: [u32; 3],
    positions: &[Option<Vec3>],
    model: &dyn RadianceField,
) -> (Vec<f64>, Vec<Option<Vec3>>) {
    let corners = (0..8_u32).map(|c| DVec3::from([0, 1, 2].map(|axis| APART * (f64::from(c >> axis & 1) - 0.5) * 2.0)));
    let corners: Vec<DVec3> = corners.collect();
    let mut points = Vec::with_capacity(8 * SAMPLES);
    for i in (0..SAMPLES).filter(|&i| positions[i].is_some()) {
        let at = sample(index, i);
        points.extend(corners.iter().filter_map(|corner| Some((i, grid.position(at + *corner)?))));
    }
    let mut densities = vec![0.0; points.len()];
    model.densities(&points.iter().map(|(_, x)| *x).collect::<Vec<_>>(), &mut densities);
    let (mut alpha, mut middles) = (vec![0.0; SAMPLES], vec![DVec3::ZERO; SAMPLES]);
    for ((i, x), sigma) in points.into_iter().zip(densities) {
        // What is not finite is left out, as rays through it are.
        if sigma > 0.0 && sigma.is_finite() {
            let share = -0.125 * (-f64::from(sigma) * grid.length(x)).exp_m1();
            alpha[i] += share;
            middles[i] += share * x.as_dvec3();
        }
    }
    let middle = |(sum, alpha): (DVec3, &f64)| (*alpha > 0.0).then(|| (sum / *alpha).as_vec3());
    let middles = middles.into_iter().zip(&alpha).map(middle).collect();
    (alpha, middles)
}

/// What the field says at the samples of a brick: what a ray towards the surface there would say, not of the air beside
/// it, in which U is larger by decades. Samples without matter get the mean of their neighbours with matter, so that
/// interpolation stays at the surface.
fn knowledge(
    (grid, index): (&Grid, [u32; 3]),
    model: &dyn RadianceField,
    field: &UncertaintyField,
    (alpha, matter): (&[f64], &[u8]),
    middles: &[Option<Vec3>],
) -> Vec<Option<Known>> {
    let seen = towards_surface(grid, index, model, alpha);
    let own: Vec<Option<Known>> = (0..SAMPLES)
        .map(|i| {
            let middle = middles[i].filter(|_| alpha[i] >= LEAST)?;
            let known = |x: Vec3| {
                let found = field.query(x);
                let is_unseen = field.knowledge(x, found.uncertainty) == Some(Knowledge::Unseen);
                Known { log10: found.uncertainty.log10(), rays: found.rays.unwrap_or(0.0), is_unseen }
            };
            if seen[i].is_empty() {
                return Some(known(middle));
            }
            let total: f64 = seen[i].iter().map(|(_, weight)| weight).sum();
            let found = seen[i].iter().map(|&(x, weight)| (known(x), weight / total));
            Some(found.fold(Known::default(), |sum, (known, share)| Known {
                log10: sum.log10 + share * known.log10,
                rays: sum.rays + share * known.rays,
                // The place where most of the light is lost decides.
                is_unseen: if share >= 0.5 { known.is_unseen } else { sum.is_unseen },
            }))
        })
        .collect();
    let mean = |i: usize| {
        let (mut sum, mut total, mut unseen) = (Known::default(), 0.0, 0.0);
        for (known, j) in neighbours(i).filter_map(|j| Some((own[j]?, j))) {
            sum.log10 += alpha[j] * known.log10;
            sum.rays += alpha[j] * known.rays;
            unseen += alpha[j] * f64::from(u8::from(known.is_unseen));
            total += alpha[j];
        }
        let is_unseen = unseen > 0.5 * total;
        (total > 0.0).then(|| Known { log10: sum.log10 / total, rays: sum.rays / total, is_unseen })
    };
    let is_asked = |i: usize| neighbours(i).any(|j| matter[j] > 0);
    (0..SAMPLES).map(|i| own[i].or_else(|| is_asked(i).then(|| mean(i)).flatten())).collect()
}

/// For every sample with a surface beside it: places along a short ray across it, from outside, with what they
/// contribute.
fn towards_surface(grid: &Grid, index: [u32; 3], model: &dyn RadianceField, alpha: &[f64]) -> Vec<Vec<(Vec3, f64)>> {
    let mut points = Vec::new();
    for i in (0..SAMPLES).filter(|&i| alpha[i] >= LEAST) {
        let Some(outwards) = outwards(alpha, i) else { continue };
        let (at, outwards) = (sample(index, i), outwards.as_dvec3());
        let places = (0..PLACES).map(|k| ACROSS * (1.0 - 2.0 * f64::from(k) / f64::from(PLACES - 1)));
        points.extend(places.filter_map(|along| Some((i, grid.position(at + along * outwards)?))));
    }
    let mut densities = vec![0.0; points.len()];
    model.densities(&points.iter().map(|(_, x)| *x).collect::<Vec<_>>(), &mut densities);
    let step = 2.0 * ACROSS / f64::from(PLACES - 1);
    let (mut found, mut transmittance) = (vec![Vec::new(); SAMPLES], vec![1.0; SAMPLES]);
    for ((i, x), sigma) in points.into_iter().zip(densities).filter(|(_, sigma)| *sigma > 0.0 && sigma.is_finite()) {
        let weight: f64 = -transmittance[i] * (-f64::from(sigma) * step * grid.length(x)).exp_m1();
        transmittance[i] -= weight;
        if weight > FAINT {
            found[i].push((x, weight));
        }
    }
    found
}

impl Codes {
    /// That hold the values of all samples.
    fn of(bricks: &[Matter], field: &UncertaintyField) -> Self {
        let all = || bricks.iter().flat_map(|brick| brick.found.iter().flatten());
        let prior = field.prior().log10();
        let low = all().map(|known| known.log10).fold(prior - 1.0, f64::min);
        let rays = all().map(|known| known.rays).fold(1.0, f64::max);
        Self { low, prior, rays: (1.0 + rays).log2() }
    }

    fn code(&self, Matter { index, matter, color, found }: Matter) -> Brick {
        let log10 = |known: &Option<Known>| match known {
            Some(known) if known.is_unseen => UNSEEN,
            Some(known) => (PRIOR * ((known.log10 - self.low) / (self.prior - self.low)).clamp(0.0, 1.0)).round() as u8,
            None => 0,
        };
        let rays = |known: &Option<Known>| {
            (RAYS * (1.0 + known.map_or(0.0, |known| known.rays)).log2() / self.rays).round() as u8
        };
        let (log10, rays) = (found.iter().map(log10).collect(), found.iter().map(rays).collect());
        Brick { index, matter, color, log10, rays }
    }
}
