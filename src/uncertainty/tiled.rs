//! A field in a folder of finished tiles. Memory caches the tiles that fit.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::Vec3;
use rayon::prelude::*;

use super::layers::Layers;
use super::merge::Head;
use super::{Answers, Estimate, Summary, Support, UncertaintyField};
use crate::octree::{CellTree, Octree, Tile, Tiling, VertexId, Wanted};
use crate::{Error, Result};

/// Points per query: enough that each tile evaluates many of them; their rays take some 100 MB.
const BATCH: usize = 1 << 16;

/// A field whose tiles are read when a point in them is queried.
///
/// Opening reads the first tile, which stays in memory, and the headers of the others. Points are
/// answered tile by tile, so that a batch reads each tile at most once, whatever the order of its points.
pub struct TiledField {
    /// In the order of their numbers.
    tiles: Vec<PathBuf>,
    /// The first of them, for what is the same in all.
    first: Arc<UncertaintyField>,
    tiling: Tiling,
    /// Bytes that loaded tiles may take; those at hand, one for each thread, may take more.
    room: usize,
    /// Cached tiles with their numbers, the last one used at the end.
    loaded: Mutex<Vec<(usize, Arc<UncertaintyField>)>>,
}

impl TiledField {
    /// Opens the tiles that [`finish_tiles`](super::finish_tiles) wrote into `folder`. Loaded ones take up to `room`
    /// bytes together.
    ///
    /// # Errors
    /// If the folder cannot be read, or does not hold all finished tiles of one run and nothing else that ends in
    /// `.oct`.
    pub fn open(folder: &Path, room: usize) -> Result<Self> {
        let paths = Self::files(folder)?;
        let heads = paths.iter().map(|path| UncertaintyField::read_head(path)).collect::<Result<Vec<Head>>>()?;
        let mut tiles: Vec<(Option<Tile>, &PathBuf, &Head)> =
            heads.iter().zip(&paths).map(|(head, path)| (head.tile, path, head)).collect();
        tiles.sort_by_key(|(tile, ..)| *tile);
        let Some((first, _, head)) = tiles.first() else {
            return Err(Error::malformed(folder, "files", "the finished tiles of a field", "no `.oct`"));
        };
        if first.is_none() {
            let path = Path::new(&head.name);
            return Err(Error::malformed(path, "tile", "a finished tile", "a field of all of space"));
        }
        let of = first.map_or(1, |tile| tile.of);
        let numbers = tiles.iter().map(|(tile, ..)| tile.map(|tile| (tile.index, tile.of)));
        if !numbers.eq((0..of).map(|index| Some((index, of)))) {
            let names = |(tile, ..): &(Option<Tile>, &PathBuf, &Head)| tile.map(|tile| tile.to_string());
            let found = tiles.iter().filter_map(names).collect::<Vec<_>>().join(", ");
            return Err(Error::malformed(folder, "files", format!("tiles 0 to {} of {of}", of - 1), found));
        }
        for (_, path, other) in &tiles {
            if other.has_sums {
                let expected = "a finished tile (`merge` finishes all tiles of a run)";
                return Err(Error::malformed(path, "tile", expected, "the sums of one"));
            }
            if (&other.record, &other.lattice, &other.ray_sets) != (&head.record, &head.lattice, &head.ray_sets) {
                return Err(Error::malformed(
                    path,
                    "tile",
                    format!("one of the run of {}", head.name),
                    "another run's",
                ));
            }
        }
        let boxes: Vec<Tile> = tiles.iter().filter_map(|(tile, ..)| *tile).collect();
        let tiling = Tiling::new(head.lattice.level(), &boxes).ok_or_else(|| {
            let found = "boxes that overlap or leave gaps";
            Error::malformed(folder, "tiles", "the tiles of one run, which together are its box", found)
        })?;
        let tiles: Vec<PathBuf> = tiles.into_iter().map(|(_, path, _)| path.clone()).collect();
        let first = Arc::new(UncertaintyField::read(&tiles[0])?);
        Ok(Self { tiles, first, tiling, room, loaded: Mutex::new(Vec::new()) })
    }

    /// The files in `folder` that opening it reads.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(folder).map_err(Error::io(folder, "cannot read"))?;
        let paths = entries.map(|entry| Ok(entry.map_err(Error::io(folder, "cannot read"))?.path()));
        let is_tile = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "oct");
        paths.filter(|path| path.as_ref().map_or(true, is_tile)).collect()
    }

    /// Whether a file holds a tile, finished or not.
    ///
    /// # Errors
    /// If its header cannot be read.
    pub fn is_tile(path: &Path) -> Result<bool> {
        UncertaintyField::read_head(path).map(|head| head.tile.is_some())
    }

    /// Number of tiles.
    #[must_use]
    pub fn tiles(&self) -> usize {
        self.tiles.len()
    }

    /// All tiles as one field in memory, bit for bit that of a run without tiles; for what needs more than answers at
    /// points.
    ///
    /// # Errors
    /// If a tile cannot be read.
    pub fn joined(&self) -> Result<UncertaintyField> {
        let finest = self.first.lattice.level();
        let mut wanted = Wanted::new(finest);
        let mut tiles = Vec::new();
        for path in &self.tiles {
            let field = UncertaintyField::read(path)?;
            // Beyond its seams a tile's leaves are coarser than the whole's, and require nothing that others do not.
            if let Support::Octree(octree) = &field.support {
                octree.cells().for_each_leaf(|leaf| wanted.cell(leaf));
            }
            if field.rays.is_empty() {
                return Err(Error::malformed(path, "section `rays`", "ray counts", "none"));
            }
            tiles.push(field);
        }
        let octree = Octree::from_wanted(wanted);
        let mut deviations = vec![f32::NAN; octree.vertex_count()];
        let mut rays = vec![0; octree.vertex_count()];
        for field in &tiles {
            let (Support::Octree(own), Some(tile)) = (&field.support, field.tile()) else { continue };
            let owned = (0..).zip(own.vertex_positions()).filter(|(_, point)| tile.owns(finest, *point));
            for (i, point) in owned {
                if let Some(VertexId(v)) = octree.vertex(point) {
                    (deviations[v as usize], rays[v as usize]) = (field.deviations.0[i], field.rays.0[i]);
                }
            }
        }
        if let Some(v) = deviations.iter().position(|deviation| deviation.is_nan()) {
            let found = format!("vertex {v} in none of them");
            return Err(Error::malformed(&self.tiles[0], "tiles", "leaves that fit at their seams", found));
        }
        let surfaces: Vec<Vec<[f32; 3]>> = tiles.iter().map(|field| field.surface().to_vec()).collect();
        let first = &*self.first;
        let (record, values) = (first.record.clone(), (deviations.into(), rays.into()));
        let support = Support::Octree(octree);
        let mut field = UncertaintyField::from_values(record, first.lattice, support, first.limits(), values);
        field.layers = Layers { tile: None, ..first.layers.clone() };
        Ok(field.with_surface(surfaces.concat()))
    }

    /// The number of the tile that owns a point; the first answers for what is outside the box.
    fn tile_of(&self, x: Vec3) -> usize {
        let cell = self.first.lattice.coordinates(x).map_or([0; 3], |u| self.first.lattice.cell(u).0);
        self.tiling.owner(cell)
    }

    /// A tile, from memory or from its file. What does not depend on the place is the same in all tiles.
    ///
    /// # Errors
    /// If its file cannot be read.
    pub fn tile(&self, index: usize) -> Result<Arc<UncertaintyField>> {
        if index == 0 {
            return Ok(Arc::clone(&self.first));
        }
        if let Some(tile) = last_asked(&mut self.loaded(), index) {
            return Ok(tile);
        }
        // Not under the lock: reading works in parallel, and a thread that waits for its parts may be given another
        // question, which would wait for the lock that it holds. So threads may read a tile twice.
        let tile = Arc::new(UncertaintyField::read(&self.tiles[index])?);
        let mut loaded = self.loaded();
        if let Some(tile) = last_asked(&mut loaded, index) {
            return Ok(tile);
        }
        let taken = |field: &UncertaintyField| field.memory().iter().map(|(_, bytes)| bytes).sum::<usize>();
        let mut all = taken(&tile) + loaded.iter().map(|(_, tile)| taken(tile)).sum::<usize>();
        while all > self.room && !loaded.is_empty() {
            all -= taken(&loaded.remove(0).1);
        }
        loaded.push((index, Arc::clone(&tile)));
        Ok(tile)
    }

    fn loaded(&self) -> MutexGuard<'_, Vec<(usize, Arc<UncertaintyField>)>> {
        // A panic elsewhere leaves the list sound: it is changed by single calls.
        self.loaded.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A tile that is at hand; it becomes the last.
fn last_asked(loaded: &mut [(usize, Arc<UncertaintyField>)], index: usize) -> Option<Arc<UncertaintyField>> {
    let at = loaded.iter().position(|(own, _)| *own == index)?;
    loaded[at..].rotate_left(1);
    loaded.last().map(|(_, tile)| Arc::clone(tile))
}

impl Answers for TiledField {
    fn facts(&self) -> &UncertaintyField {
        &self.first
    }

    fn points_at_once(&self) -> usize {
        BATCH
    }

    fn estimates(&self, points: &[Vec3]) -> Result<Vec<Estimate>> {
        let mut order: Vec<(usize, usize)> = points.iter().map(|&x| self.tile_of(x)).zip(0..).collect();
        order.sort_unstable();
        let mut estimates = vec![self.first.outside(); points.len()];
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            let own: Vec<Vec3> = group.iter().map(|&(_, i)| points[i]).collect();
            let found = self.tile(group[0].0)?.estimates(&own)?;
            group.iter().zip(found).for_each(|(&(_, i), found)| estimates[i] = found);
        }
        Ok(estimates)
    }

    fn surface(&self) -> Result<Cow<'_, [[f32; 3]]>> {
        let surfaces =
            (0..self.tiles.len()).map(|i| Ok(self.tile(i)?.surface().to_vec())).collect::<Result<Vec<_>>>()?;
        Ok(Cow::Owned(surfaces.concat()))
    }

    /// Beyond its seams a tile's leaves are coarser than the whole's, and split nowhere else.
    fn cells(&self) -> Result<Option<Cow<'_, CellTree>>> {
        let finest = self.first.lattice.level();
        let mut split = vec![Vec::new(); usize::from(finest)];
        for i in 0..self.tiles.len() {
            let Support::Octree(octree) = &self.tile(i)?.support else { continue };
            for (all, own) in split.iter_mut().zip(octree.cells().split()) {
                all.extend(own);
            }
        }
        for codes in &mut split {
            codes.par_sort_unstable();
            codes.dedup();
        }
        Ok(Some(Cow::Owned(CellTree::from_split(finest, &split))))
    }

    /// Bytes are those of all tiles, which share some vertices.
    fn summary(&self) -> Result<Summary> {
        let finest = self.first.lattice.level();
        let (mut vertices, mut query_bytes, mut structure_bytes) = (0, 0, 0);
        for i in 0..self.tiles.len() {
            let field = self.tile(i)?;
            let (Support::Octree(octree), Some(tile)) = (&field.support, field.tile()) else { continue };
            vertices += octree.vertex_positions().filter(|point| tile.owns(finest, *point)).count() as u64;
            let own = field.summary();
            query_bytes += own.query_bytes;
            structure_bytes += own.structure_bytes;
        }
        let leaves_per_level = self.cells()?.map_or_else(Vec::new, |cells| cells.leaves_per_level());
        Ok(Summary { grid: "octree", level: finest, vertices, query_bytes, structure_bytes, leaves_per_level })
    }
}
