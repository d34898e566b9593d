//! Puts tiles together: one octree for all of them, and the values at its vertices, tile by tile.
//!
//! A tile's sums are those of the whole run, but balance makes the refinement of the octree depend on the cells beyond
//! its seams. So the tiles are read twice: first for the cells that they require, then for their values. Tiles that are
//! queried separately are read once more in between, for the values at leaves that lie across seams.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::parts::Head;
use super::shards;
use crate::geometry::Lattice;
use crate::octree::{Cell, MaxLevels, Octree, Tile, Tiling, VertexId, Wanted, cells_around};
use crate::posterior::{OctreePosterior, RayCoverage, VertexSums};
use crate::rays::RaySet;
use crate::uncertainty::by_vertex::encode;
use crate::uncertainty::{RunRecord, Support, UncertaintyField};
use crate::{Error, Result};

/// Refuses tiles that do not cover the box, or that not all rays were summed in. `groups` has the parts of each.
pub fn check(groups: &[(Tile, Vec<&Head>)]) -> Result<()> {
    let Some((first, parts)) = groups.first() else { return Ok(()) };
    let names = |parts: &[&Head]| parts.iter().map(|head| head.name.as_str()).collect::<Vec<_>>().join(", ");
    // By number, then by box: tiles of one number that differ stand beside each other.
    if let Some([(tile, a), (_, b)]) = groups.windows(2).find(|pair| pair[0].0.index == pair[1].0.index) {
        let expected = "tiles of runs with the same --rays, which decides where space is cut";
        let found = format!("two boxes of tile {tile}: in {} and in {}", names(a), names(b));
        return Err(Error::setting("tiles to merge", expected, found));
    }
    let missing = (0..first.of).filter(|i| groups.iter().all(|(tile, _)| tile.index != *i));
    let missing: Vec<String> = missing.map(|i| format!("{i}/{}", first.of)).collect();
    if !missing.is_empty() {
        let found = format!("none of {}", missing.join(", "));
        return Err(Error::setting("tiles to merge", format!("all {} tiles", first.of), found));
    }
    let ray_sets = shards::ray_sets(parts);
    for (tile, parts) in groups {
        let own = shards::ray_sets(parts);
        if own.is_empty() || own.iter().any(RaySet::is_part) {
            let expected = format!("all shards of tile {tile}");
            return Err(Error::setting("tiles to merge", expected, format!("{} alone", names(parts))));
        }
        if own != ray_sets {
            let expected = format!("the rays of tile {first} in tile {tile}, too");
            return Err(Error::setting("tiles to merge", expected, format!("others in {}", names(parts))));
        }
    }
    let boxes: Vec<Tile> = groups.iter().map(|(tile, _)| *tile).collect();
    match Tiling::new(parts[0].lattice.level(), &boxes) {
        Some(_) => Ok(()),
        None => {
            let expected = "the tiles of one run, which together are its box";
            Err(Error::setting("tiles to merge", expected, "boxes that overlap or leave gaps"))
        }
    }
}

/// What must be known of all tiles before one of them can be finished.
pub struct Survey {
    record: RunRecord,
    lattice: Lattice,
    limits: MaxLevels,
    ray_sets: Vec<RaySet>,
    /// The octree of the whole.
    octree: Octree,
    tiles: Vec<Tile>,
    /// Sums at the vertices that a tile needs of another.
    seams: FxHashMap<[u32; 3], VertexSums>,
    surfaces: Vec<Vec<[f32; 3]>>,
    ray_coverage: Option<RayCoverage>,
}

impl Survey {
    /// Reads all tiles once, in their order, one at a time.
    pub fn read(tiles: impl IntoIterator<Item = Result<UncertaintyField>>) -> Result<Self> {
        let mut survey: Option<(Self, Wanted)> = None;
        for part in tiles {
            let part = part?;
            let sums = part.own_sums()?;
            let (survey, wanted) = survey.get_or_insert_with(|| Self::begin(&part));
            if part.limits() != survey.limits {
                let expected = "the leaves of the first tile in all of them";
                return Err(Error::setting("tiles to merge", expected, "others"));
            }
            let record = &mut survey.record;
            if record.criteria.sensitivity {
                let wants = sums.wanted(record.reading().floor());
                *wanted = std::mem::replace(wanted, Wanted::new(part.lattice.level())) | wants;
            }
            record.dropped = record.dropped.max(part.record.dropped);
            survey.tiles.extend(part.tile());
            survey.ray_coverage = survey.ray_coverage.take().zip(part.ray_coverage()).map(|(mut sum, more)| {
                sum += more;
                sum
            });
            survey.surfaces.push(part.surface().to_vec());
        }
        let (survey, wanted) = survey.ok_or_else(|| Error::setting("tiles to merge", "two or more", "none"))?;
        Ok(Self { octree: Octree::from_wanted(wanted), ..survey })
    }

    /// Nothing but the settings of the first tile.
    fn begin(first: &UncertaintyField) -> (Self, Wanted) {
        let level = first.lattice.level();
        let survey = Self {
            record: first.record.clone(),
            lattice: first.lattice,
            limits: first.limits(),
            ray_sets: first.ray_sets().to_vec(),
            octree: Octree::refined(level, []),
            tiles: Vec::new(),
            seams: FxHashMap::default(),
            surfaces: Vec::new(),
            ray_coverage: first.ray_coverage().map(|_| RayCoverage::new(&first.lattice)),
        };
        (survey, Wanted::new(level))
    }

    fn value(&self, point: [u32; 3], sums: VertexSums) -> (f32, u8) {
        (self.record.reading().deviation_at(&self.limits, point, sums), encode(sums.rays))
    }

    fn field(&self, octree: Octree, values: (Vec<f32>, Vec<u8>)) -> UncertaintyField {
        let values = (values.0.into(), values.1.into());
        let (record, limits) = (self.record.clone(), self.limits.clone());
        let field = UncertaintyField::from_values(record, self.lattice, Support::Octree(octree), limits, values);
        field.with_ray_sets(self.ray_sets.clone()).with_ray_coverage(self.ray_coverage.clone())
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
        let surface = self.surfaces.concat();
        Ok(self.field(self.octree.clone(), (deviations, rays)).with_surface(surface))
    }

    /// Reads all tiles a second time, for the sums that each needs of the others. They stay in memory.
    pub fn read_seams(&mut self, tiles: impl IntoIterator<Item = Result<UncertaintyField>>) -> Result<()> {
        let finest = self.lattice.level();
        for tile in &self.tiles {
            let octree = self.octree_of(*tile);
            let foreign = octree.vertex_positions().filter(|point| !tile.owns(finest, *point));
            self.seams.extend(foreign.map(|point| (point, VertexSums::default())));
        }
        for part in tiles {
            let part = part?;
            let sums = part.own_sums()?;
            let is_own = |point| part.tile().is_some_and(|tile| tile.owns(finest, point));
            self.seams.par_iter_mut().filter(|(point, _)| is_own(**point)).for_each(|(point, own)| {
                *own = sums.sums(*point);
            });
        }
        Ok(())
    }

    /// A tile that answers by itself for every point in it as the whole does: its leaves, those around them, and the
    /// values at all of its vertices. [Seams](Self::read_seams) must have been read.
    pub fn finish(&self, part: &UncertaintyField) -> Result<UncertaintyField> {
        let sums = part.own_sums()?;
        let tile = part.tile().ok_or_else(|| Error::setting("tiles to merge", "a tile", "a field of all of space"))?;
        let finest = self.lattice.level();
        let octree = self.octree_of(tile);
        let at = |point| match tile.owns(finest, point) {
            true => sums.sums(point),
            false => self.seams.get(&point).copied().unwrap_or_default(),
        };
        let (mut deviations, mut rays) = (Vec::new(), Vec::new());
        let values = octree.par_vertex_positions().map(|point| self.value(point, at(point)));
        values.unzip_into_vecs(&mut deviations, &mut rays);
        let mut field = self.field(octree, (deviations, rays)).with_surface(part.surface().to_vec());
        field.layers.tile = Some(tile);
        Ok(field)
    }

    /// The octree of a tile: the leaves of the whole that touch it, on which corners in it may hang, and those around
    /// the corners of leaves that lie across a seam.
    fn octree_of(&self, tile: Tile) -> Octree {
        let finest = self.lattice.level();
        let (low, high) = tile.extent(finest);
        let touches = |cell: Cell| {
            let (origin, edge) = cell.extent(finest);
            (0..3).all(|axis| origin[axis] <= high[axis] && origin[axis] + edge >= low[axis])
        };
        let mut wanted = Wanted::new(finest);
        let cells = self.octree.cells();
        cells.for_each_leaf_where(touches, |leaf| {
            wanted.cell(leaf);
            let (origin, edge) = leaf.extent(finest);
            let is_asked = (0..3).all(|axis| origin[axis] < high[axis] && origin[axis] + edge > low[axis]);
            for c in (0..8_u32).filter(|_| is_asked) {
                let corner: [u32; 3] = std::array::from_fn(|axis| origin[axis] + edge * (c >> axis & 1));
                if (0..3).any(|axis| corner[axis] < low[axis] || corner[axis] > high[axis]) {
                    cells_around(corner, finest).for_each(|cell| wanted.cell(cells.leaf(cell)));
                }
            }
        });
        Octree::from_wanted(wanted)
    }
}

impl UncertaintyField {
    /// The sums of a tile as they were when its rays had been drawn.
    fn own_sums(&self) -> Result<OctreePosterior> {
        let (Support::Octree(octree), Some(sums)) = (&self.support, self.sums()) else {
            return Err(Error::setting("tiles to merge", "tiles with their sums", "a tile that is finished"));
        };
        let mut posterior = OctreePosterior::limited(self.lattice, self.limits());
        let touched = octree.vertex_positions().zip(sums).filter(|(_, sums)| sums.rays > 0);
        touched.for_each(|(point, sums)| posterior.add_sums_at(point, sums));
        Ok(posterior)
    }
}
