//! What a view would show, found by some of its pixels' rays through the model. Its image is not needed: Gauss-Newton's
//! Hessian has Jacobians only.

use glam::Vec3;
use rustc_hash::FxHashMap;

use super::coverage::Facet;
use super::look::{Look, Points, in_front, stands_in_matter};
use crate::Result;
use crate::geometry::{Camera, Lattice};
use crate::monitor::Monitor;
use crate::posterior::{Posterior, RayCoverage};
use crate::rays::{PixelSample, PixelSequence, Pixels, RaySource};
use crate::render::VisibleSegment;
use crate::splats::{Use, tile_of};
use crate::uncertainty::{Added, Precision};

/// Rays that are differentiated together, as in a run.
const BATCH: usize = 512;

/// Why a view tells nothing.
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
    pub source: &'a RaySource<'a>,
    /// Where in a pixel its ray passes.
    pub pixel_offset: f64,
    /// What rays are added to; `None` if only their ends count.
    pub precision: Option<&'a Precision<'a>>,
    /// Where training rays passed.
    pub ray_coverage: Option<&'a RayCoverage>,
    /// The cells of facets.
    pub cells: Lattice,
    /// Most pixels of a view.
    pub pixels: u64,
    /// Seed of pixels and jitter.
    pub seed: u64,
}

impl Viewer<'_> {
    /// Whether cameras are to be looked through one after the other: if the model is asked from the calling thread, for
    /// many points at once, or if a view takes memory and is itself prepared by all threads.
    pub fn takes_turns(&self) -> bool {
        self.source.volume().is_none_or(|volume| volume.tracer.field.batch() > 0)
    }

    /// The camera in front of the model, to be differentiated if that counts.
    fn look(&self, camera: &Camera) -> Look<'_> {
        Look::new(self.source, camera, if self.precision.is_some() { Use::Derivatives } else { Use::Colors })
    }

    /// The rays of a view: all of them cameras' first pixels of the same low-discrepancy sequence. Of splats, those of
    /// one tile follow each other, whose splats then stay in the cache.
    pub fn points(&self, camera: &Camera) -> Vec<Points> {
        let count = self.pixels.min(camera.pixels());
        let mut picks = PixelSequence::new(Pixels::Sobol, self.seed, vec![camera.resolution]).picks(0, count);
        if self.source.splats().is_some() {
            picks.sort_by_key(|pick| tile_of(pick.pixel.map(f64::from)));
        }
        let batch = |(n, picks): (usize, &[PixelSample])| Points {
            at: picks.iter().map(|pick| pick.pixel.map(|i| f64::from(i) + self.pixel_offset)).collect(),
            jitter: picks.iter().map(|pick| pick.jitter).collect(),
            first: (n * BATCH) as u64,
        };
        picks.chunks(BATCH).enumerate().map(batch).collect()
    }

    /// What a view would show.
    ///
    /// # Errors
    /// As [`Look::samples`].
    pub fn evidence(&self, camera: &Camera, monitor: &dyn Monitor) -> Result<Evidence> {
        let (look, points) = (self.look(camera), self.points(camera));
        let rays: u64 = points.iter().map(|points| points.at.len() as u64).sum();
        let mut evidence = Evidence { rays, pixels: camera.pixels(), ..Evidence::default() };
        let sight = match self.precision {
            None => look.sight(&points)?,
            Some(precision) => {
                let samples = look.samples(&points, monitor)?;
                let mut sums = precision.sums();
                sums.add(&samples);
                evidence.added = precision.added(&sums, camera.pixels() as f64 / rays as f64);
                samples.into_iter().flat_map(|batch| batch.sight).collect()
            }
        };
        self.note_ends(camera, &sight, &mut evidence);
        if evidence.blank.is_some() {
            evidence.added.clear();
            evidence.facets.clear();
        }
        Ok(evidence)
    }

    /// Notes where rays end, and why they tell nothing if they do not.
    fn note_ends(&self, camera: &Camera, sight: &[VisibleSegment], evidence: &mut Evidence) {
        let (bounds, in_front) = (self.source.bounds(), in_front(self.source));
        let mut seen: FxHashMap<usize, glam::DVec3> = FxHashMap::default();
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
            *seen.entry(cell).or_default() -= ray.direction;
            if let Some(cell) = self.ray_coverage.and_then(|ray_coverage| ray_coverage.cell(x)) {
                *ends.entry(cell).or_default() += 1;
            }
        }
        let facet = |(cell, towards): (usize, glam::DVec3)| Some(Facet { cell, towards: towards.try_normalize()? });
        evidence.facets = seen.into_iter().filter_map(facet).collect();
        evidence.facets.sort_unstable_by_key(|facet| facet.cell);
        evidence.ends = ends.into_iter().collect();
        evidence.ends.sort_unstable();
        let nothing = if self.precision.is_some() { evidence.added.is_empty() } else { evidence.facets.is_empty() };
        evidence.blank = if stands_in_matter(self.source, camera, sight) {
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

/// Number of the cell around a point; `None` outside the domain.
fn cell_of(cells: &Lattice, x: Vec3) -> Option<usize> {
    let cell = cells.cell(cells.coordinates(x)?).0;
    Some(cell.into_iter().fold(0, |index, i| index << cells.level() | i as usize))
}
