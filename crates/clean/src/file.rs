//! The file of a volume: which cells of it may go, and how what is left is written.

use std::path::Path;

use glam::Vec3;
use octobayes::estimate::Model;
use octobayes::field::VoxelGrid;
use octobayes::geometry::Domain;
use octobayes::monitor::Monitor;
use octobayes::{Error, Result};
use octobayes_models::{HashGrid, read_voxel_grid, write_voxel_grid};

use crate::{Cells, CleanedVolume, Strength};

/// Most cells along the longest edge, if the model does not have its own.
const CELLS: f64 = 128.0;

/// A volume by its file. It is read once more as what it is: an open model is any volume.
#[derive(Debug, Clone)]
pub enum VolumeFile {
    /// A hash grid, with its occupancy.
    HashGrid(Box<HashGrid>),
    /// A voxel grid.
    Voxels(VoxelGrid),
    /// Neither.
    Other,
}

/// What a model is written with, if it becomes a voxel grid.
#[derive(Clone, Copy)]
pub struct Baking<'a> {
    /// The model.
    pub model: &'a dyn Model,
    /// Points along the longest edge of its box.
    pub points: u32,
    /// Where the cameras are, scene units: each point is seen from the nearest.
    pub eyes: &'a [Vec3],
}

impl Baking<'_> {
    /// Points along the longest edge by default.
    pub const POINTS: u32 = 256;

    /// Along x, y and z.
    fn shape(&self) -> [usize; 3] {
        let size = self.model.whole_box().size();
        let along = |edge: f64| ((edge / size.max_element() * f64::from(self.points)).round() as usize).max(2);
        size.to_array().map(along)
    }
}

impl VolumeFile {
    /// The file of a model, by its name: a path, or a built-in scene.
    ///
    /// # Errors
    /// If it cannot be read again.
    pub fn of(name: &str) -> Result<Self> {
        let path = Path::new(name);
        Ok(match () {
            () if name.starts_with("scene:") => Self::Other,
            () if has_extension(path, "safetensors") && HashGrid::is_in(path)? => {
                Self::HashGrid(Box::new(HashGrid::read(path)?))
            }
            () if has_extension(path, "npz") => Self::Voxels(read_voxel_grid(path)?),
            () => Self::Other,
        })
    }

    /// The cells that may go: those of a hash grid's occupancy, else up to 128 along an edge. Each has a point of the
    /// voxel grid that is read or written at least: a finer cell would change nothing.
    ///
    /// # Errors
    /// If there are too many.
    pub fn cells(&self, model: &dyn Model, points: u32) -> Result<Cells> {
        let points = match self {
            Self::HashGrid(grid) => return Cells::new(*grid.domain(), [grid.finest_occupancy() as u32; 3]),
            Self::Voxels(grid) => grid.shape(),
            Self::Other => Baking { model, points, eyes: &[] }.shape(),
        };
        let domain = model.natural_domain();
        let size = domain.size();
        let cells = |k: usize| (size[k] / size.max_element() * CELLS).round().clamp(1.0, points[k] as f64) as u32;
        Cells::new(domain, [0, 1, 2].map(cells))
    }

    /// What a file of this name has no place for, beside what goes.
    ///
    /// # Errors
    /// If it cannot hold the model.
    pub fn not_kept(&self, output: &Path, baking: &Baking) -> Result<Option<String>> {
        match self {
            Self::HashGrid(_) if has_extension(output, "safetensors") => Ok(None),
            Self::Voxels(_) if has_extension(output, "npz") => Ok(None),
            _ if has_extension(output, "npz") => {
                let far = match baking.model.natural_domain() {
                    Domain::Box(_) => "",
                    Domain::Contracted { .. } => ", which are as far apart in the middle as far away",
                };
                let [x, y, z] = baking.shape();
                Ok(Some(format!(
                    "colours that depend on the direction, and what is between its {x} x {y} x {z} points{far}"
                )))
            }
            _ => {
                let expected = "`.npz`, a voxel grid of any volume, or `.safetensors` of a hash grid of `train`";
                Err(Error::setting("--output", expected, output.display().to_string()))
            }
        }
    }

    /// Writes what is left at a strength. `found` is of the [cells](Self::cells) of this file.
    ///
    /// # Errors
    /// As [`VolumeFile::not_kept`], if the model is no volume, if the file cannot be written, or
    /// [`Error::Interrupted`].
    pub fn write(
        &self,
        found: &CleanedVolume,
        strength: Strength,
        output: &Path,
        baking: &Baking,
        monitor: &dyn Monitor,
    ) -> Result<()> {
        self.not_kept(output, baking)?;
        let removed = found.is_removed(strength);
        let goes = |x: Vec3| found.cells.around(x).is_some_and(|cell| removed[cell]);
        match self {
            Self::HashGrid(grid) if has_extension(output, "safetensors") => grid.without(&removed).write(output),
            Self::Voxels(grid) => write_voxel_grid(&grid.clone().without(goes), output),
            _ => {
                let model = baking.model;
                let field = model.field().ok_or_else(|| Error::setting("model", "a volume", model.kind()))?;
                let grid = VoxelGrid::bake_from(field, baking.shape(), baking.eyes, monitor)?;
                write_voxel_grid(&grid.without(goes), output)
            }
        }
    }
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found == extension)
}
