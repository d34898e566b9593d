//! The cells of a field, dense or octree, without listing them in memory.

use glam::{DVec3, Vec3};

use octobayes::geometry::Lattice;
use octobayes::octree::{Cell, CellTree, morton};
use octobayes::uncertainty::{Answer, Support, UncertaintyField};

/// Cells per query: enough to keep all threads busy, a few megabytes.
const CHUNK: usize = 1 << 16;

/// The leaves of a lattice in Morton order. Without an octree these are all of its cells.
pub fn leaves<'a>(lattice: &Lattice, cells: Option<&'a CellTree>) -> impl Iterator<Item = Cell> + use<'a> {
    let level = lattice.level();
    let mut next = 0_u64;
    std::iter::from_fn(move || {
        if next >> (3 * level) > 0 {
            return None;
        }
        let finest = morton::decode(next);
        let leaf = cells.map_or(Cell { level, index: finest }, |cells| cells.leaf(finest));
        // A leaf's finest cells are neighbours in this order.
        next += 1 << (3 * (level - leaf.level));
        Some(leaf)
    })
}

/// Whether a field stores ray counts, and whether it stores ray coverage.
pub fn knows(field: &UncertaintyField) -> [bool; 2] {
    let lattice = field.lattice();
    let middle = lattice.position(DVec3::splat(0.5 * f64::from(lattice.cells_per_axis()))).as_vec3();
    let answers = field.answers(&[middle]);
    let any = |has: fn(&Answer) -> bool| answers.iter().any(has);
    [any(|answer| answer.estimate.rays.is_some()), any(|answer| answer.ray_coverage.is_some())]
}

/// The split cells of every level above the finest, as Morton codes in order.
pub enum Splits {
    /// All of them.
    Dense {
        /// The finest level.
        finest: u8,
    },
    /// Those of an octree.
    Octree(Vec<Vec<u64>>),
}

impl Splits {
    /// Of a field.
    pub fn of(field: &UncertaintyField) -> Self {
        match field.support() {
            Support::Dense => Self::Dense { finest: field.lattice().level() },
            Support::Octree(octree) => Self::Octree(octree.cells().split()),
        }
    }

    /// The split cells of a level.
    fn codes(&self, level: u8) -> Box<dyn Iterator<Item = u64> + '_> {
        match self {
            Self::Dense { finest } if level < *finest => Box::new(0..1 << (3 * level)),
            Self::Dense { .. } => Box::new(std::iter::empty()),
            Self::Octree(split) => Box::new(split.get(usize::from(level)).into_iter().flatten().copied()),
        }
    }

    /// Number of cells of each level, leaves and split ones, down to the finest level that has any.
    pub fn cells_per_level(&self) -> Vec<u64> {
        let mut cells = vec![1];
        for level in 0.. {
            let split = match self {
                Self::Dense { finest } if level < *finest => 1_u64 << (3 * level),
                Self::Dense { .. } => 0,
                Self::Octree(split) => split.get(usize::from(level)).map_or(0, |codes| codes.len() as u64),
            };
            if split == 0 {
                break;
            }
            cells.push(8 * split);
        }
        cells
    }

    /// The cells of a level in Morton order, each with whether it is split.
    pub fn cells(&self, level: u8) -> impl Iterator<Item = (Cell, bool)> + '_ {
        let children: Box<dyn Iterator<Item = u64>> = match level {
            0 => Box::new(std::iter::once(0)),
            _ => Box::new(self.codes(level - 1).flat_map(|parent| (0..8).map(move |c| parent << 3 | c))),
        };
        let mut split = self.codes(level).peekable();
        children.map(move |code| {
            let is_split = split.next_if_eq(&code).is_some();
            (Cell { level, index: morton::decode(code) }, is_split)
        })
    }
}

/// Centre of a cell, scene units.
pub fn center(lattice: &Lattice, cell: Cell) -> DVec3 {
    lattice.position(middle(lattice, cell))
}

/// Distances between the centres of opposite faces, scene units along x, y and z.
pub fn edges(lattice: &Lattice, cell: Cell) -> DVec3 {
    let half = 0.5 * f64::from(cell.extent(lattice.level()).1);
    let middle = middle(lattice, cell);
    let along = |axis: DVec3| {
        let [low, high] = [-half, half].map(|shift| lattice.position(middle + shift * axis));
        (high - low).length()
    };
    DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
}

/// Lattice coordinates of a cell's centre.
fn middle(lattice: &Lattice, cell: Cell) -> DVec3 {
    let (origin, edge) = cell.extent(lattice.level());
    DVec3::from(origin.map(f64::from)) + 0.5 * f64::from(edge)
}

/// The field's values at the centres of `cells`, queried chunk by chunk.
pub fn at_centers<'a>(
    field: &'a UncertaintyField,
    cells: impl Iterator<Item = Cell> + 'a,
) -> impl Iterator<Item = Answer> + 'a {
    in_chunks(cells, |cells| {
        let centers: Vec<Vec3> = cells.iter().map(|&cell| center(field.lattice(), cell).as_vec3()).collect();
        field.answers(&centers)
    })
}

/// Maps items chunk by chunk.
pub fn in_chunks<'a, T, U: 'a>(
    mut items: impl Iterator<Item = T> + 'a,
    map: impl Fn(Vec<T>) -> Vec<U> + 'a,
) -> impl Iterator<Item = U> + 'a {
    std::iter::from_fn(move || {
        let chunk: Vec<T> = items.by_ref().take(CHUNK).collect();
        (!chunk.is_empty()).then(|| map(chunk))
    })
    .flatten()
}
