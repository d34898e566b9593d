//! Adds up the sums of different rays.

use rayon::prelude::*;

use super::Merging;
use super::parts::{Head, Part};
use crate::geometry::Lattice;
use crate::octree::{Cell, MaxLevels};
use crate::posterior::overflow::Overflow;
use crate::posterior::{Entries, Reading, Refinement, VertexSums};
use crate::rays::RaySet;
use crate::uncertainty::layers::Layers;
use crate::uncertainty::{Finish, RunRecord, Support, UncertaintyField};
use crate::{Error, Result};

/// Vertices that are added before the room is looked at.
const VERTICES_PER_CHECK: u64 = 1 << 12;
/// Points on surfaces that are kept of parts, before their number is that of the part with most: 12 MB.
const SURFACE_POINTS: usize = 1 << 20;

/// What is joined, and how.
pub struct Joining<'a> {
    settings: &'a Merging,
    /// Those of all parts, as they are given.
    heads: &'a [Head],
    /// In which order they are added.
    order: Vec<usize>,
    ray_sets: Vec<RaySet>,
    record: RunRecord,
}

impl<'a> Joining<'a> {
    pub fn new(settings: &'a Merging, heads: &'a [Head], order: Vec<usize>) -> Self {
        let of: Vec<&Head> = order.iter().map(|&i| &heads[i]).collect();
        let ray_sets = ray_sets(&of);
        let record = record(&of, &ray_sets);
        Self { settings, heads, order, ray_sets, record }
    }

    /// Whether the field is made of a copy of all sums.
    fn gathers_sums(&self) -> bool {
        let is_part = self.record.is_part() || self.ray_sets.iter().any(RaySet::is_part);
        self.settings.keep_sums || is_part || self.record.pooling.is_on()
    }

    /// What the joined field needs of S.
    pub fn entries(&self) -> Entries {
        if self.gathers_sums() { Entries::All } else { self.record.covariance.entries() }
    }

    /// Adds the parts, one after the other.
    pub fn join<P: Finish>(&self, parts: &[impl Part]) -> Result<UncertaintyField> {
        // While a group is added, others may be in memory.
        let room = self.settings.room / if self.settings.error_bars { 2 } else { 1 };
        let overflow = Overflow::new(room, &self.settings.scratch, None);
        let lattice = self.heads[self.order[0]].lattice;
        let mut beside = Beside::default();
        // Those of all parts, or of each.
        let mut sums: Vec<P> = Vec::new();
        for &i in &self.order {
            let (support, layers) = parts[i].without_sums()?;
            beside.add(self, i, &layers)?;
            if let (true, Support::Octree(octree)) = (self.keeps_leaves(), &*support) {
                octree.cells().for_each_leaf(|leaf| beside.wanted.push(leaf));
                beside.wanted.par_sort_unstable_by_key(|cell| (cell.level, cell.index));
                beside.wanted.dedup();
            }
            if sums.is_empty() || self.settings.error_bars {
                sums.push(P::empty(lattice, &beside.limits(&lattice)));
            }
            let last = sums.len() - 1;
            self.add(&mut sums[last], &parts[i], i, &support, &overflow)?;
            let has_left = sums.iter().any(|group| !group.runs().is_empty());
            if self.settings.error_bars && (has_left || sums.iter().map(P::memory).sum::<usize>() > room) {
                sums.iter_mut().try_for_each(|group| overflow.spill_to_one(group))?;
            }
        }
        let whole = if self.settings.error_bars {
            let mut whole = P::empty(lattice, &beside.limits(&lattice));
            sums.iter().for_each(|group| whole += group);
            whole
        } else {
            sums.pop().expect("there are parts")
        };
        let field = self.field(whole, lattice, beside, &overflow)?;
        if !self.settings.error_bars {
            return Ok(field);
        }
        let rays: Vec<u64> = self.order.iter().map(|&i| self.heads[i].record.rays).collect();
        field.with_error_bars(&sums, &rays)
    }

    /// Whether what was refined for reasons other than information stays refined.
    fn keeps_leaves(&self) -> bool {
        self.record.criteria.density || self.record.criteria.uniform
    }

    /// Adds the sums of the part of number `i`.
    fn add<P: Finish>(
        &self,
        to: &mut P,
        part: &impl Part,
        i: usize,
        support: &Support,
        overflow: &Overflow,
    ) -> Result<()> {
        let lattice = self.heads[i].lattice;
        let mut points: Box<dyn Iterator<Item = [u32; 3]>> = match support {
            Support::Octree(octree) => Box::new(octree.vertex_positions()),
            Support::Dense => Box::new((0..support.vertices(&lattice)).map(|v| lattice.dense_point(v as usize))),
        };
        let mut count = 0_u64;
        part.each_sums(support.vertices(&lattice), &mut |sums| {
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

    /// The field of all sums.
    fn field<P: Finish>(
        &self,
        mut sums: P,
        lattice: Lattice,
        beside: Beside,
        overflow: &Overflow,
    ) -> Result<UncertaintyField> {
        overflow.spill_rest(&mut sums)?;
        let Beside { layers, most, wanted } = beside;
        let reading = self.record.reading();
        let of: Vec<&Head> = self.order.iter().map(|&i| &self.heads[i]).collect();
        let floor = floor(&of, &self.ray_sets);
        let vertices = sums.vertices(&Refinement::above(floor, &reading, self.record.criteria, wanted))?;
        let mut field = sums.field(self.record.clone(), lattice, vertices, self.gathers_sums())?;
        let mut layers = layers.unwrap_or_default();
        if let Some(surface) = &mut layers.surface {
            surface.truncate(most);
        }
        let (sums, ray_coverage) = (field.layers.sums.take(), layers.ray_coverage.take());
        field.layers = Layers { sums, ..layers };
        let field = field.with_ray_coverage(ray_coverage);
        Ok(if self.settings.keep_sums { field } else { field.for_queries() })
    }
}

/// What fields have beside their sums.
#[derive(Default)]
struct Beside {
    layers: Option<Layers>,
    /// Largest number of points on surfaces of a part.
    most: usize,
    /// Cells that must exist regardless of the sums.
    wanted: Vec<Cell>,
}

impl Beside {
    /// Adds the layers of the part of number `i`.
    fn add(&mut self, joining: &Joining, i: usize, own: &Layers) -> Result<()> {
        match &mut self.layers {
            None => self.layers = Some(own.to_merge()),
            Some(layers) if layers.limits != own.limits => {
                let expected = format!("those of {}", joining.heads[joining.order[0]].name);
                let what = format!("limits to refinement of {}", joining.heads[i].name);
                return Err(Error::setting(what, expected, "others"));
            }
            Some(layers) => layers.merge(own),
        }
        self.most = self.most.max(own.surface.as_ref().map_or(0, Vec::len));
        if let Some(surface) = self.layers.as_mut().and_then(|layers| layers.surface.as_mut()) {
            surface.truncate(self.most.max(SURFACE_POINTS));
        }
        Ok(())
    }

    /// Those of all parts.
    fn limits(&self, lattice: &Lattice) -> MaxLevels {
        let limits = self.layers.as_ref().and_then(|layers| layers.limits.clone());
        limits.unwrap_or_else(|| MaxLevels::none(lattice.level()))
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
