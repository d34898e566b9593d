//! What a view would show, found by some of its pixels' rays through the model. Its image is not needed: Gauss-Newton's
//! Hessian has Jacobians only.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use super::Region;
use super::coverage::Facet;
use octobayes::geometry::{Camera, Lattice};
use octobayes::monitor::Monitor;
use octobayes::posterior::{Posterior, RayCoverage};
use octobayes::rays::{MAX_DROPPED_SHARE, PixelSample, PixelSequence, Pixels};
use octobayes::render::{CameraView, ImagePoints, Outputs, RaySamples, Renderer, VisibleSegment};
use octobayes::uncertainty::{Added, Precision};
use octobayes::{Error, Result};

/// Rays that are differentiated together, as in a run.
const BATCH: usize = 512;

/// Why a view adds nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Blank {
    /// The camera stands in matter: half of its rays end within four samples, or a splat takes half of the light where
    /// it is.
    InMatter,
    /// No ray crosses the model's box.
    PastTheBox,
    /// Rays cross the box, but none meets matter in the field's domain that a displacement would move.
    MeetsNothing,
}

impl Blank {
    /// In words, for tables.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::InMatter => "stands in matter",
            Self::PastTheBox => "looks past the box",
            Self::MeetsNothing => "meets nothing that a displacement would move",
        }
    }
}

/// What a view would show.
#[derive(Debug, Clone, Default)]
pub struct Evidence {
    /// What its pixels add to the precision, by Morton code.
    pub added: Vec<Added>,
    /// The cells that its rays end in, and from where they are seen, by cell.
    pub facets: Vec<Facet>,
    /// The cells of the field's ray coverage that its rays end in, and how many do.
    pub ends: Vec<(usize, u32)>,
    /// Rays, and those of them that end on a surface in the field's domain.
    pub rays: u64,
    /// See [`Evidence::rays`].
    pub met: u64,
    /// Number of the view's pixels.
    pub pixels: u64,
    /// Why it shows nothing, whatever a gain counts.
    pub blank: Option<Blank>,
}

/// Shows what candidates would see.
pub struct Viewer<'a> {
    /// The model and how its rays are differentiated.
    pub source: &'a dyn Renderer,
    /// Where in a pixel its ray passes.
    pub pixel_offset: f64,
    /// What rays are added to; `None` if only their ends count.
    pub precision: Option<&'a Precision<'a>>,
    /// Where training rays passed.
    pub ray_coverage: Option<&'a RayCoverage>,
    /// The cells of facets.
    pub cells: Lattice,
    /// The places that count.
    pub region: Option<Region<'a>>,
    /// Most pixels of a view.
    pub pixels: u64,
    /// Seed of pixels and jitter.
    pub seed: u64,
}

impl Viewer<'_> {
    /// Whether cameras are to be looked through one after the other: if the model is evaluated from the calling thread,
    /// for many points at once, or if a view takes memory and is itself prepared by all threads.
    pub fn takes_turns(&self) -> bool {
        self.source.marched().is_none() || self.source.batch() > 0
    }

    /// The rays of a view: all of them cameras' first pixels of the same low-discrepancy sequence. Those of one tile
    /// follow each other.
    pub fn points(&self, camera: &Camera) -> Vec<ImagePoints> {
        let count = self.pixels.min(camera.pixels());
        let mut picks = PixelSequence::new(Pixels::Sobol, self.seed, vec![camera.resolution]).picks(0, count);
        picks.sort_by_key(|pick| self.source.tile_of(pick.pixel.map(f64::from)));
        let batch = |(n, picks): (usize, &[PixelSample])| ImagePoints {
            at: picks.iter().map(|pick| pick.pixel.map(|i| f64::from(i) + self.pixel_offset)).collect(),
            jitter: picks.iter().map(|pick| pick.jitter).collect(),
            first: (n * BATCH) as u64,
        };
        picks.chunks(BATCH).enumerate().map(batch).collect()
    }

    /// Whether a place, scene units, counts.
    pub fn counts(&self, x: DVec3) -> bool {
        self.region.is_none_or(|region| region(x))
    }

    /// What a view would show.
    ///
    /// # Errors
    /// As [`samples`].
    pub fn evidence(&self, camera: &Camera, monitor: &dyn Monitor) -> Result<Evidence> {
        let outputs = if self.precision.is_some() { Outputs::Derivatives } else { Outputs::Colors };
        let (view, points) = (self.source.view(camera, outputs), self.points(camera));
        let rays: u64 = points.iter().map(|points| points.at.len() as u64).sum();
        let mut evidence = Evidence { rays, pixels: camera.pixels(), ..Evidence::default() };
        let seen = match self.precision {
            None => finite(view.sight(&points), &points)?,
            Some(precision) => {
                let samples = samples(&*view, &points, monitor)?;
                let mut sums = precision.sums();
                sums.add(&samples);
                evidence.added = precision.added(&sums, camera.pixels() as f64 / rays as f64);
                evidence.added.retain(|added| self.counts(precision.position(added)));
                samples
            }
        };
        let sight: Vec<VisibleSegment> = seen.into_iter().flat_map(|batch| batch.sight).collect();
        self.note_ends(camera, &sight, &mut evidence);
        if evidence.blank.is_some() {
            evidence.added.clear();
            evidence.facets.clear();
        }
        Ok(evidence)
    }

    /// Notes where rays end, and why they add nothing if they do not.
    fn note_ends(&self, camera: &Camera, sight: &[VisibleSegment], evidence: &mut Evidence) {
        // Rays of a model that is not marched end at centres, which lie on the surface.
        let in_front = self.source.march_step().unwrap_or(0.0);
        let bounds = self.source.bounds();
        let mut seen: FxHashMap<usize, DVec3> = FxHashMap::default();
        let mut ends: FxHashMap<usize, u32> = FxHashMap::default();
        let mut crossing = 0;
        for VisibleSegment { ray, until } in sight {
            crossing += usize::from(bounds.clip(ray).is_some());
            if !until.is_finite() {
                continue;
            }
            // In front of the surface rather than behind it: there training rays have passed, if any did.
            let x = ray.at((until - in_front).max(0.0)).as_vec3();
            let Some(cell) = cell_of(&self.cells, x) else { continue };
            evidence.met += 1;
            if !self.counts(x.as_dvec3()) {
                continue;
            }
            *seen.entry(cell).or_default() -= ray.direction;
            if let Some(cell) = self.ray_coverage.and_then(|ray_coverage| ray_coverage.cell(x)) {
                *ends.entry(cell).or_default() += 1;
            }
        }
        let facet = |(cell, towards): (usize, DVec3)| Some(Facet { cell, towards: towards.try_normalize()? });
        evidence.facets = seen.into_iter().filter_map(facet).collect();
        evidence.facets.sort_unstable_by_key(|facet| facet.cell);
        evidence.ends = ends.into_iter().collect();
        evidence.ends.sort_unstable();
        let nothing = if self.precision.is_some() { evidence.added.is_empty() } else { evidence.facets.is_empty() };
        evidence.blank = if self.source.stands_in_matter(camera, sight) {
            Some(Blank::InMatter)
        } else if crossing == 0 {
            Some(Blank::PastTheBox)
        } else {
            nothing.then_some(Blank::MeetsNothing)
        };
    }
}

impl Evidence {
    /// Share of the rays that end on a surface that neither a training ray nor a view before reached; `None` if it is
    /// not known where training rays passed, or if no ray ends on a surface.
    pub fn unseen_share(&self, is_seen: impl Fn(usize) -> bool) -> Option<f64> {
        let all: u32 = self.ends.iter().map(|(_, rays)| rays).sum();
        let new: u32 = self.ends.iter().filter(|(cell, _)| !is_seen(*cell)).map(|(_, rays)| rays).sum();
        (all > 0).then(|| f64::from(new) / f64::from(all))
    }

    /// Bytes on the heap.
    pub fn memory(&self) -> usize {
        let Self { added, facets, ends, .. } = self;
        size_of_val(&added[..]) + size_of_val(&facets[..]) + size_of_val(&ends[..])
    }
}

/// The samples of rays, with their Jacobians.
///
/// # Errors
/// [`Error::NonFinite`] if more than [`MAX_DROPPED_SHARE`] of the rays were dropped, or [`Error::Interrupted`].
pub fn samples(view: &dyn CameraView, points: &[ImagePoints], monitor: &dyn Monitor) -> Result<Vec<RaySamples>> {
    finite(view.samples(points, monitor)?, points)
}

/// Refuses samples if too many of their rays were dropped.
fn finite(samples: Vec<RaySamples>, points: &[ImagePoints]) -> Result<Vec<RaySamples>> {
    let rays: u64 = points.iter().map(|points| points.at.len() as u64).sum();
    let dropped: u64 = samples.iter().map(|batch| batch.dropped).sum();
    match samples.iter().find_map(|batch| batch.first_invalid) {
        Some(first) if dropped as f64 > MAX_DROPPED_SHARE * rays as f64 => {
            let limit_percent = 100.0 * MAX_DROPPED_SHARE;
            Err(Error::NonFinite { dropped, rays, limit_percent, first: first.to_array() })
        }
        _ => Ok(samples),
    }
}

/// Number of the cell around a point; `None` outside the domain.
fn cell_of(cells: &Lattice, x: Vec3) -> Option<usize> {
    let cell = cells.cell(cells.coordinates(x)?).0;
    Some(cell.into_iter().fold(0, |index, i| index << cells.level() | i as usize))
}
