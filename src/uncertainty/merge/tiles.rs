//! Puts tiles together: one octree for all of them, and the values at its vertices, tile by tile.
//!
//! A tile's sums are those of the whole run, but where the octree is refined depends, by balance, on what lies beyond
//! its seams. So the tiles are read twice: first for the cells that they want and the sums on their seams, then for
//! their values.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::parts::Head;
use super::shards;
use crate::geometry::Lattice;
use crate::octree::{Cell, MaxLevels, Octree, Tile, VertexId, Wanted};
use crate::posterior::{OctreePosterior, VertexSums, Visits};
use crate::rays::Draw;
use crate::uncertainty::from_sums::value;
use crate::uncertainty::{Protocol, RayCounts, StandardDeviations, Support, UncertaintyField};
use crate::{Error, Result};

/// Refuses tiles that do not cover the box, or that not all rays were summed in. `groups` has the parts of each.
pub fn check(groups: &[(Tile, Vec<&Head>)]) -> Result<()> {
    let Some((first, parts)) = groups.first() else { return Ok(()) };
    let missing = (0..first.of).filter(|i| groups.iter().all(|(tile, _)| tile.index != *i));
    let missing: Vec<String> = missing.map(|i| format!("{i}/{}", first.of)).collect();
    if !missing.is_empty() {
        let found = format!("none of {}", missing.join(", "));
        return Err(Error::setting("tiles to merge", format!("all {} tiles", first.of), found));
    }
    let draws = shards::draws(parts);
    for (tile, parts) in groups {
        let own = shards::draws(parts);
        let names = || parts.iter().map(|head| head.name.as_str()).collect::<Vec<_>>().join(", ");
        if own.is_empty() || own.iter().any(Draw::is_part) {
            let expected = format!("all shards of tile {tile}");
            return Err(Error::setting("tiles to merge", expected, format!("{} alone", names())));
        }
        if own != draws {
            let expected = format!("the rays of tile {first} in tile {tile}, too");
            return Err(Error::setting("tiles to merge", expected, format!("others in {}", names())));
        }
    }
    Ok(())
}

/// What must be known of all tiles before one of them can be finished.
pub struct Survey {
    protocol: Protocol,
    lattice: Lattice,
    limits: MaxLevels,
    draws: Vec<Draw>,
    /// The octree of the whole.
    octree: Octree,
    /// Sums at the vertices that lie on a lower face of their tile: its neighbours have them, too.
    seams: FxHashMap<[u32; 3], VertexSums>,
    surfaces: Vec<Vec<[f32; 3]>>,
    visits: Option<Visits>,
}

impl Survey {
    /// Reads all tiles once, in their order. Of each, only what lies on seams stays in memory.
    pub fn read(tiles: impl IntoIterator<Item = Result<UncertaintyField>>) -> Result<Self> {
        let mut survey: Option<(Self, Wanted)> = None;
        for part in tiles {
            let part = part?;
            let sums = part.own_sums()?;
            let (survey, wanted) = survey.get_or_insert_with(|| Self::begin(&part));
            if part.limits != survey.limits {
                let expected = "the leaves of the first tile in all of them";
                return Err(Error::setting("tiles to merge", expected, "others"));
            }
            let (tile, protocol) = (part.tile, &mut survey.protocol);
            if protocol.criteria.sensitivity {
                let wants = sums.wanted(protocol.floor(protocol.rays));
                *wanted = std::mem::replace(wanted, Wanted::new(part.lattice.level())) | wants;
            }
            protocol.dropped = protocol.dropped.max(part.protocol.dropped);
            let low = tile.map_or([0; 3], |tile| tile.extent(part.lattice.level()).0);
            let on_seam = |point: &[u32; 3]| (0..3).any(|axis| point[axis] == low[axis]);
            let on_seams = sums.touched().filter(|(point, _)| on_seam(point)).map(|(point, sums)| (point, *sums));
            survey.seams.extend(on_seams.collect::<Vec<_>>());
            survey.visits = survey.visits.take().zip(part.visits).map(|(mut sum, more)| {
                sum += &more;
                sum
            });
            survey.surfaces.push(part.surface);
        }
        let (survey, wanted) = survey.ok_or_else(|| Error::setting("tiles to merge", "two or more", "none"))?;
        Ok(Self { octree: Octree::from_wanted(wanted), ..survey })
    }

    /// Nothing but the settings of the first tile.
    fn begin(first: &UncertaintyField) -> (Self, Wanted) {
        let level = first.lattice.level();
        let survey = Self {
            protocol: first.protocol.clone(),
            lattice: first.lattice,
            limits: first.limits.clone(),
            draws: first.draws.clone(),
            octree: Octree::refined(level, []),
            seams: FxHashMap::default(),
            surfaces: Vec::new(),
            visits: first.visits.as_ref().map(|_| Visits::new(&first.lattice)),
        };
        (survey, Wanted::new(level))
    }

    fn value(&self, point: [u32; 3], sums: VertexSums) -> (f32, u8) {
        value(&self.protocol, &self.octree, &self.limits, point, sums)
    }

    fn field(&self, octree: Octree, values: (Vec<f32>, Vec<u8>)) -> UncertaintyField {
        let values = (StandardDeviations(values.0), RayCounts(values.1));
        let (protocol, limits) = (self.protocol.clone(), self.limits.clone());
        let field = UncertaintyField::from_values(protocol, self.lattice, Support::Octree(octree), limits, values);
        field.with_draws(self.draws.clone()).with_visits(self.visits.clone())
    }

    /// One field of all tiles, which are read a second time. It takes 5.4 to 5.8 bytes a vertex, its octree included;
    /// beside it are the sums of one tile at a time.
    pub fn join(self, tiles: impl IntoIterator<Item = Result<UncertaintyField>>) -> Result<UncertaintyField> {
        let points = self.octree.par_vertex_positions();
        let (mut deviations, mut rays) = (Vec::new(), Vec::new());
        points.map(|point| self.value(point, VertexSums::default())).unzip_into_vecs(&mut deviations, &mut rays);
        for part in tiles {
            let sums = part?.own_sums()?;
            let known = sums.touched().filter_map(|(point, _)| {
                let VertexId(v) = self.octree.vertex(point)?;
                Some((v as usize, self.value(point, sums.sums(point))))
            });
            for (v, (deviation, count)) in known.collect::<Vec<_>>() {
                (deviations[v], rays[v]) = (deviation, count);
            }
        }
        let surface = in_turn(&self.surfaces);
        Ok(self.field(self.octree.clone(), (deviations, rays)).with_surface(surface))
    }

    /// A tile that answers by itself for every point in it as the whole does: its leaves, those that touch it, and the
    /// values at all of its vertices.
    pub fn finish(&self, part: &UncertaintyField) -> Result<UncertaintyField> {
        let sums = part.own_sums()?;
        let tile = part.tile.ok_or_else(|| Error::setting("tiles to merge", "a tile", "a field of all of space"))?;
        let finest = self.lattice.level();
        let octree = Octree::refined(finest, self.leaves_touching(tile));
        let (low, high) = tile.extent(finest);
        let is_in = |point: [u32; 3]| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]));
        let at = |point| match tile.owns(finest, point) {
            true => sums.sums(point),
            false if is_in(point) => self.seams.get(&point).copied().unwrap_or_default(),
            // Beyond the seams nothing is asked.
            false => VertexSums::default(),
        };
        let (mut deviations, mut rays) = (Vec::new(), Vec::new());
        let values = octree.par_vertex_positions().map(|point| self.value(point, at(point)));
        values.unzip_into_vecs(&mut deviations, &mut rays);
        let field = self.field(octree, (deviations, rays)).with_surface(part.surface.clone());
        Ok(UncertaintyField { tile: Some(tile), ..field })
    }

    /// The leaves of the whole inside a tile and those that touch it from outside, on which its corners may hang.
    fn leaves_touching(&self, tile: Tile) -> Vec<Cell> {
        let finest = self.lattice.level();
        let (low, high) = tile.extent(finest);
        let touches = |cell: Cell| {
            let (origin, edge) = cell.extent(finest);
            (0..3).all(|axis| origin[axis] <= high[axis] && origin[axis] + edge >= low[axis])
        };
        let mut leaves = Vec::new();
        self.octree.cells().for_each_leaf_where(touches, |leaf| leaves.push(leaf));
        leaves
    }
}

impl UncertaintyField {
    /// The sums of a tile as they were when its rays had been drawn.
    fn own_sums(&self) -> Result<OctreePosterior> {
        let (Support::Octree(octree), Some(sums)) = (&self.support, self.sums()) else {
            return Err(Error::setting("tiles to merge", "tiles with their sums", "a tile that is finished"));
        };
        let mut posterior = OctreePosterior::limited(self.lattice, self.limits.clone());
        let touched = octree.vertex_positions().zip(sums).filter(|(_, sums)| sums.rays > 0);
        touched.for_each(|(point, sums)| posterior.add_sums_at(point, sums));
        Ok(posterior)
    }
}

/// As many points as the list with the most has, from all lists in turn.
pub fn in_turn(lists: &[Vec<[f32; 3]>]) -> Vec<[f32; 3]> {
    let most = lists.iter().map(Vec::len).max().unwrap_or(0);
    let rounds = (0..most).flat_map(|n| lists.iter().filter_map(move |list| list.get(n)));
    rounds.take(most).copied().collect()
}
