//! Volumes: what is left as a hash grid or a voxel grid.

use std::path::Path;

use glam::Vec3;
use octobayes::estimate::Model;
use octobayes::field::{Radiance, RadianceField, TrainedField, VoxelGrid};
use octobayes::geometry::{Aabb, Domain};
use octobayes::monitor::Monitor;
use octobayes::{Error, Result};
use octobayes_clean::{Cells, Cleaned, CleanedVolume, Reason, Strength};
use octobayes_models::{HashGrid, read_voxel_grid, write_voxel_grid};
use octobayes_session::OpenedModel;

use super::found::{Found, TINTS, grey};

/// Most cells along the longest edge, if the model does not have its own.
const CELLS: f64 = 128.0;

/// What is written of a volume. It is read again as what it is: an open model is any volume.
pub enum Kind {
    /// The model with fewer occupied cells.
    HashGrid(Box<HashGrid>),
    /// The model without the density of some points.
    Voxels(VoxelGrid),
    /// The model at points of a grid of so many along x, y and z.
    Baked([usize; 3]),
}

impl Kind {
    /// Which of them a file of this name will hold.
    ///
    /// # Errors
    /// If it can hold none, or if the model cannot be read again.
    pub fn new(model: &OpenedModel, output: &Path, points: usize) -> Result<Self> {
        let name = Path::new(&model.name);
        let is_named = |path: &Path, extension: &str| path.extension().is_some_and(|found| found == extension);
        if is_named(output, "safetensors") && is_named(name, "safetensors") && HashGrid::is_in(name)? {
            return HashGrid::read(name).map(|grid| Self::HashGrid(Box::new(grid)));
        }
        if is_named(output, "npz") {
            let is_scene = model.name.starts_with("scene:");
            let has_points = !is_scene && is_named(name, "npz");
            if has_points {
                return read_voxel_grid(name).map(Self::Voxels);
            }
            let size = model.model.whole_box().size();
            let along = |edge: f64| ((edge / size.max_element() * points as f64).round() as usize).max(2);
            return Ok(Self::Baked(size.to_array().map(along)));
        }
        let expected = "`.npz`, a voxel grid of any volume, or `.safetensors` of a hash grid of `train`";
        Err(Error::setting("--output", expected, format!("{} of {}", output.display(), model.name)))
    }

    /// The cells that may go. Of a voxel grid, each has a point of it at least: a finer cell would change nothing.
    pub fn cells(&self, model: &dyn Model) -> Result<Cells> {
        let points = match self {
            Self::HashGrid(grid) => return Cells::new(*grid.domain(), [grid.finest_occupancy() as u32; 3]),
            Self::Voxels(grid) => grid.shape(),
            Self::Baked(shape) => *shape,
        };
        let domain = model.natural_domain();
        let size = domain.size();
        let cells = |k: usize| (size[k] / size.max_element() * CELLS).round().clamp(1.0, points[k] as f64) as u32;
        Cells::new(domain, [0, 1, 2].map(cells))
    }

    /// What a file of this kind loses of the model, beside what goes.
    pub fn loses(&self, model: &dyn Model) -> Option<String> {
        let Self::Baked([x, y, z]) = self else { return None };
        let far = match model.natural_domain() {
            Domain::Box(_) => "",
            Domain::Contracted { .. } => ", which are as far apart in the middle as far away",
        };
        Some(format!("colours that depend on the direction, and what is between its {x} x {y} x {z} points{far}"))
    }
}

/// A volume and what goes of it.
pub struct FoundVolume<'a> {
    pub model: &'a dyn Model,
    pub field: &'a dyn RadianceField,
    pub kind: Kind,
    pub found: CleanedVolume,
    /// Where the cameras are, scene units.
    pub eyes: Vec<Vec3>,
}

impl Found for FoundVolume<'_> {
    fn parts(&self) -> &'static str {
        "cells"
    }

    fn cleaned(&self) -> &Cleaned {
        &self.found.cleaned
    }

    fn number(&self, i: usize) -> usize {
        self.found.parts[i]
    }

    fn center(&self, i: usize) -> Vec3 {
        self.found.cells.center(self.found.parts[i])
    }

    fn before(&self) -> &dyn Model {
        self.model
    }

    fn left(&self, strength: Strength) -> Result<Box<dyn Model + '_>> {
        let removed = self.is_removed(strength);
        Ok(match &self.kind {
            Kind::HashGrid(grid) => Box::new(grid.without(&removed)),
            Kind::Voxels(grid) => Box::new(grid.clone().without(self.is_in(&removed))),
            // Not at the points that are written, which may take minutes.
            Kind::Baked(_) => Box::new(self.by_cell(strength, Shown::Left)),
        })
    }

    fn marked(&self, strength: Strength) -> Box<dyn Model + '_> {
        Box::new(self.by_cell(strength, Shown::Marked))
    }
}

impl FoundVolume<'_> {
    fn is_removed(&self, strength: Strength) -> Vec<bool> {
        self.found.removed(strength).iter().map(Option::is_some).collect()
    }

    fn is_in<'s>(&'s self, cells: &'s [bool]) -> impl Fn(Vec3) -> bool + 's {
        |x| self.found.cells.around(x).is_some_and(|cell| cells[cell])
    }

    fn by_cell(&self, strength: Strength, shown: Shown) -> ByCell<'_> {
        ByCell { field: self.field, cells: self.found.cells, reasons: self.found.removed(strength), shown }
    }

    /// Writes what stays.
    pub fn write(&self, strength: Strength, output: &Path, monitor: &dyn Monitor) -> Result<()> {
        let removed = self.is_removed(strength);
        match &self.kind {
            Kind::HashGrid(grid) => grid.without(&removed).write(output),
            Kind::Voxels(grid) => write_voxel_grid(&grid.clone().without(self.is_in(&removed)), output),
            Kind::Baked(shape) => {
                let grid = VoxelGrid::bake_from(self.field, *shape, &self.eyes, monitor)?;
                write_voxel_grid(&grid.without(self.is_in(&removed)), output)
            }
        }
    }
}

/// What is shown of a field whose cells may go.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// What stays.
    Left,
    /// All in grey, but for the cells that go, which have the colours of their reasons.
    Marked,
}

/// A field, and cells of it that go.
struct ByCell<'a> {
    field: &'a dyn RadianceField,
    cells: Cells,
    reasons: Vec<Option<Reason>>,
    shown: Shown,
}

impl ByCell<'_> {
    fn reason(&self, x: Vec3) -> Option<Reason> {
        self.cells.around(x).and_then(|cell| self.reasons[cell])
    }
}

impl RadianceField for ByCell<'_> {
    fn bounds(&self) -> Aabb {
        self.field.bounds()
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.field.evaluate(positions, directions, out);
        for (x, out) in positions.iter().zip(out) {
            match (self.reason(*x), self.shown) {
                (Some(_), Shown::Left) => out.density = 0.0,
                (None, Shown::Left) => {}
                (Some(reason), Shown::Marked) => out.color = TINTS[reason as usize].1,
                (None, Shown::Marked) => out.color = grey(out.color),
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        self.field.densities(positions, out);
        if self.shown == Shown::Left {
            let removed = positions.iter().zip(out).filter(|(x, _)| self.reason(**x).is_some());
            removed.for_each(|(_, density)| *density = 0.0);
        }
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        self.field.density_bound(min, max)
    }

    fn suggested_step(&self) -> f64 {
        self.field.suggested_step()
    }

    fn batch(&self) -> usize {
        self.field.batch()
    }
}

impl TrainedField for ByCell<'_> {}
