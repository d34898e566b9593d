//! Adds up the sums of different rays.

use rayon::prelude::*;

use super::Merging;
use super::parts::{Head, Part};
use crate::geometry::Lattice;
use crate::octree::Cell;
use crate::posterior::overflow::Overflow;
use crate::posterior::{Entries, Reading, Refinement, VertexSums};
use crate::rays::RaySet;
use crate::uncertainty::layers::Layers;
use crate::uncertainty::{Finish, RunRecord, Support, UncertaintyField};
use crate::{Error, Result};

/// Vertices that are added before the room is looked at.
const VERTICES_PER_CHECK: u64 = 1 << 12;
/// Points on surfaces that are kept of parts, before their number is that of the part with most: 12 MB.
const MAX_SURFACE_POINTS: usize = 1 << 20;

/// Parts that are joined, and how.
pub struct Joining<'a, P> {
    settings: &'a Merging,
    /// In the order in which they are added.
    parts: Vec<&'a P>,
    /// Of each part.
    heads: Vec<&'a Head>,
    ray_sets: Vec<RaySet>,
    record: RunRecord,
}

impl<'a, P: Part> Joining<'a, P> {
    /// Of `parts` with these `heads`, which are added in this `order`.
    pub fn new(settings: &'a Merging, parts: &'a [P], heads: &'a [Head], order: &[usize]) -> Self {
        let parts = order.iter().map(|&i| &parts[i]).collect();
        let heads: Vec<&Head> = order.iter().map(|&i| &heads[i]).collect();
        let ray_sets = ray_sets(&heads);
        let record = record(&heads, &ray_sets);
        Self { settings, parts, heads, ray_sets, record }
    }

    /// Whether the field is made of a copy of all sums.
    fn gathers_sums(&self) -> bool {
        let is_part = self.record.is_part_by(&self.ray_sets);
        self.record.pooling.gathers_sums(is_part, self.settings.keep_sums)
    }

    /// What the joined field needs of S.
    pub fn entries(&self) -> Entries {
        if self.gathers_sums() { Entries::All } else { self.record.covariance.entries() }
    }

    /// Adds the parts, one after the other.
    pub fn join<S: Finish>(&self) -> Result<UncertaintyField> {
        let has_groups = self.settings.error_bars;
        // While a group is added, others may be in memory.
        let room = self.settings.room / if has_groups { 2 } else { 1 };
        let overflow = Overflow::new(room, &self.settings.scratch, None);
        let lattice = self.heads[0].lattice;
        let mut beside = Beside::default();
        // Those of all parts, or of each.
        let mut sums: Vec<S> = Vec::new();
        for (part, head) in self.parts.iter().zip(&self.heads) {
            let (support, layers) = part.without_sums(head)?;
            beside.add(&layers, [self.heads[0], head])?;
            if self.record.criteria.density || self.record.criteria.uniform {
                beside.keep_leaves(&support);
            }
            if sums.is_empty() || has_groups {
                sums.push(S::empty(lattice, &layers.limits(&lattice)));
            }
            let last = sums.len() - 1;
            add(&mut sums[last], (*part, head), &support, &overflow)?;
            let has_left = sums.iter().any(|group| !group.runs().is_empty());
            if has_groups && (has_left || sums.iter().map(S::memory).sum::<usize>() > room) {
                sums.iter_mut().try_for_each(|group| overflow.spill_to_one(group))?;
            }
        }
        if !has_groups {
            let mut whole = sums.pop().expect("there are parts");
            overflow.spill_rest(&mut whole)?;
            return self.field(whole, lattice, beside);
        }
        let mut whole = sums[0].clone();
        sums[1..].iter().for_each(|group| whole += group);
        let rays: Vec<u64> = self.heads.iter().map(|head| head.record.rays).collect();
        self.field(whole, lattice, beside)?.with_error_bars(&sums, &rays)
    }

    /// The field of all sums.
    fn field<S: Finish>(&self, sums: S, lattice: Lattice, beside: Beside) -> Result<UncertaintyField> {
        let Beside { mut layers, most, wanted } = beside;
        let floor = floor(&self.heads, &self.ray_sets);
        let refinement = Refinement::above(floor, &self.record.reading(), self.record.criteria, wanted);
        let vertices = sums.vertices(&refinement)?;
        drop(refinement);
        let mut field = sums.field(self.record.clone(), lattice, vertices, self.gathers_sums())?;
        if let Some(surface) = &mut layers.surface {
            surface.truncate(most);
        }
        let (sums, ray_coverage) = (field.layers.sums.take(), layers.ray_coverage.take());
        field.layers = Layers { sums, ..layers };
        let field = field.with_ray_coverage(ray_coverage);
        Ok(if self.settings.keep_sums { field } else { field.for_queries() })
    }
}

/// Adds the sums of a part, whose vertices are those of `support`.
fn add(to: &mut impl Finish, (part, head): (&impl Part, &Head), support: &Support, overflow: &Overflow) -> Result<()> {
    let lattice = &head.lattice;
    let mut points: Box<dyn Iterator<Item = [u32; 3]>> = match support {
        Support::Octree(octree) => Box::new(octree.vertex_positions()),
        Support::Dense => Box::new((0..support.vertices(lattice)).map(|v| lattice.dense_point(v as usize))),
    };
    let mut count = 0_u64;
    part.each_sums(head, support.vertices(lattice), &mut |sums| {
        let point = points.next().expect("sums of a field are one per vertex");
        // Vertices that only balance the octree take no room.
        if sums != VertexSums::default() {
            to.add_sums(point, &sums);
        }
        count += 1;
        if count.is_multiple_of(VERTICES_PER_CHECK) { overflow.spill_if_full(to).map(|_| ()) } else { Ok(()) }
    })?;
    overflow.spill_if_full(to).map(|_| ())
}

/// What fields have beside their sums.
#[derive(Default)]
struct Beside {
    layers: Layers,
    /// Largest number of points on surfaces of a part.
    most: usize,
    /// Cells that must exist regardless of the sums.
    wanted: Vec<Cell>,
}

impl Beside {
    /// Adds the layers of the next part; these are the heads of the first and of this one.
    fn add(&mut self, own: &Layers, [first, head]: [&Head; 2]) -> Result<()> {
        if std::ptr::eq(first, head) {
            self.layers = own.to_merge();
        } else if self.layers.limits == own.limits {
            self.layers.merge(own);
        } else {
            let what = format!("limits to refinement of {}", head.name);
            return Err(Error::setting(what, format!("those of {}", first.name), "others"));
        }
        let own = own.surface.as_ref().map_or(0, Vec::len);
        self.most = self.most.max(own);
        if let Some(surface) = &mut self.layers.surface {
            surface.truncate(self.most.max(MAX_SURFACE_POINTS));
        }
        Ok(())
    }

    /// Keeps refined what is.
    fn keep_leaves(&mut self, support: &Support) {
        if let Support::Octree(octree) = support {
            octree.cells().for_each_leaf(|leaf| self.wanted.push(leaf));
            self.wanted.par_sort_unstable_by_key(|cell| (cell.level, cell.index));
            self.wanted.dedup();
        }
    }
}

/// The rays of all parts; unknown if those of one part are.
fn ray_sets(of: &[&Head]) -> Vec<RaySet> {
    if of.iter().any(|head| head.ray_sets.is_empty()) {
        return Vec::new();
    }
    RaySet::joined(of.iter().flat_map(|head| &head.ray_sets).copied())
}

/// The information that may still be left out where octrees are joined: together with what the parts left out,
/// it is negligible for all rays.
///
/// Shards lack nothing, and nothing is left out as long as some shards are missing. A vertex that the octree of a
/// whole run lacks may have lost what was negligible for the rays of that run. Every vertex considered here
/// belongs to some part, whose sums are complete there.
fn floor(of: &[&Head], ray_sets: &[RaySet]) -> f64 {
    if ray_sets.iter().any(RaySet::is_part) {
        return Refinement::EVERYTHING;
    }
    let of_shards = of.iter().flat_map(|head| &head.ray_sets).filter(|ray_set| ray_set.is_part());
    let complete = of_shards.fold(0_u64, |sum, ray_set| sum.saturating_add(ray_set.shard.own_rays()));
    let runs = of.iter().map(|head| head.record.rays);
    let rays = if complete > 0 { complete } else { runs.min().unwrap_or(0) };
    Reading { rays, ..of[0].record.reading() }.floor()
}

/// The record of the joined run of these sets. It is a whole run again if all its shards are present.
fn record(of: &[&Head], ray_sets: &[RaySet]) -> RunRecord {
    let records = || of.iter().map(|head| &head.record);
    let first = &of[0].record;
    let one_seed = first.seed.filter(|_| records().all(|p| p.seed == first.seed));
    let whole = match ray_sets {
        [ray_set] if one_seed == Some(ray_set.seed) => Some(ray_set.shard),
        _ => None,
    };
    let mut sources: Vec<&str> = records().map(|p| p.source.as_str()).collect();
    sources.dedup();
    RunRecord {
        source: sources.join(" + "),
        rays: records().fold(0, |sum, p| sum.saturating_add(p.rays)),
        dropped: records().fold(0, |sum, p| sum.saturating_add(p.dropped)),
        seed: one_seed,
        shard: whole,
        ..first.clone()
    }
}
