//! Volumes: what is left of them, and what goes, as fields that can be shown.

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::Model;
use octobayes::field::{Radiance, RadianceField, TrainedField};
use octobayes::geometry::Aabb;
use octobayes_clean::{Cells, Cleaned, CleanedVolume, Reason, Strength, VolumeFile};

use super::found::{Found, TINTS, grey};

/// A volume and what goes of it.
pub struct FoundVolume<'a> {
    pub model: &'a dyn Model,
    pub field: &'a dyn RadianceField,
    pub file: &'a VolumeFile,
    pub found: CleanedVolume,
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
        let removed = self.found.is_removed(strength);
        Ok(match self.file {
            VolumeFile::HashGrid(grid) => Box::new(grid.without(&removed)),
            VolumeFile::Voxels(grid) => {
                let goes = |x: Vec3| self.found.cells.around(x).is_some_and(|cell| removed[cell]);
                Box::new(grid.clone().without(goes))
            }
            // Not at the points that are written, which may take minutes.
            VolumeFile::Other => Box::new(self.by_cell(strength, Shown::Left)),
        })
    }

    fn marked(&self, strength: Strength) -> Box<dyn Model + '_> {
        Box::new(self.by_cell(strength, Shown::Marked))
    }
}

impl FoundVolume<'_> {
    fn by_cell(&self, strength: Strength, shown: Shown) -> ByCell<'_> {
        ByCell { field: self.field, cells: self.found.cells, reasons: self.found.removed(strength), shown }
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
