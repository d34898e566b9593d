//! Cells of a volume as parts.
//!
//! A grid divides the space that the model covers. What a ray meets in a cell is a part of its pixel as a splat is, so
//! that the same rule says which cells go.

use glam::{DVec3, Vec3};
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::{Camera, Domain};
use octobayes::render::Renderer;
use octobayes::{Error, Result};
use octobayes_splats::stride_for;
use rayon::prelude::*;

use crate::evidence::Parts;
use crate::run::Listing;
use crate::views::{Listed, ListedPoints, ListedRow, ListedView, Views};
use crate::{Clean, Cleaned, Reason, Rule, Strength};

/// What takes less of the light in a cell is not listed.
const LEAST_ALPHA: f64 = 1e-4;
/// A cell holds matter if a ray along its edge loses this part of its light in it.
const LEAST_MATTER: f64 = 0.01;

/// The cells of a grid over a space, x fastest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cells {
    domain: Domain,
    /// Along x, y and z.
    n: [u32; 3],
}

impl Cells {
    /// Most cells along an edge: their numbers have 32 bits.
    const MOST: u32 = 1024;

    /// Divides `domain` into `n` cells along x, y and z.
    ///
    /// # Errors
    /// If a number is 0 or above 1024.
    pub fn new(domain: Domain, n: [u32; 3]) -> Result<Self> {
        if n.iter().all(|n| (1..=Self::MOST).contains(n)) {
            return Ok(Self { domain, n });
        }
        Err(Error::setting("cells", format!("1 to {} along an edge", Self::MOST), format!("{n:?}")))
    }

    /// Number of all cells.
    #[must_use]
    pub fn count(&self) -> usize {
        self.n.iter().map(|&n| n as usize).product()
    }

    /// The cell around a place; `None` outside the space.
    #[must_use]
    pub fn around(&self, x: Vec3) -> Option<usize> {
        let u = self.domain.to_unit(x)?;
        Some(self.index([0, 1, 2].map(|k| ((u[k] * f64::from(self.n[k])) as usize).min(self.n[k] as usize - 1))))
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.n[1] as usize + y) * self.n[0] as usize + x
    }

    fn place(&self, cell: usize) -> [usize; 3] {
        let [nx, ny, _] = self.n.map(|n| n as usize);
        [cell % nx, cell / nx % ny, cell / (nx * ny)]
    }

    /// The middle of a cell, scene units.
    #[must_use]
    pub fn center(&self, cell: usize) -> Vec3 {
        self.scene(cell, 0.5).as_vec3()
    }

    fn scene(&self, cell: usize, share: f64) -> DVec3 {
        let place = self.place(cell);
        self.domain.to_scene(DVec3::from([0, 1, 2].map(|k| (place[k] as f64 + share) / f64::from(self.n[k]))))
    }

    /// The edge of a cube with the diagonal of a cell, scene units.
    fn edge(&self, cell: usize) -> f64 {
        (self.scene(cell, 1.0) - self.scene(cell, 0.0)).length() / 3_f64.sqrt()
    }

    /// The cells that touch one at a face, an edge or a corner.
    fn beside(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (cells, place) = (*self, self.place(cell));
        let near = move |k: usize| place[k].saturating_sub(1)..(place[k] + 2).min(cells.n[k] as usize);
        near(2).flat_map(move |z| near(1).flat_map(move |y| near(0).map(move |x| cells.index([x, y, z]))))
    }
}

/// The cells of a volume that pixels show or no camera has in its image (with [`Clean::hidden`] all with matter), and
/// what goes of them.
#[derive(Debug, Clone)]
pub struct CleanedVolume {
    /// The grid.
    pub cells: Cells,
    /// `[n]`: the cell of each part, increasing.
    pub parts: Vec<usize>,
    /// The parts and what goes of them.
    pub cleaned: Cleaned,
    /// `[cells]`: whether it is no part and holds no matter.
    is_thin: Vec<bool>,
}

impl CleanedVolume {
    /// `[n]`: the middle of each part, scene units.
    #[must_use]
    pub fn centers(&self) -> Vec<Vec3> {
        self.parts.iter().map(|&cell| self.cells.center(cell)).collect()
    }

    /// `[cells]`: whether a cell [goes](Self::removed) at a strength.
    #[must_use]
    pub fn is_removed(&self, strength: Strength) -> Vec<bool> {
        self.removed(strength).iter().map(Option::is_some).collect()
    }

    /// `[cells]`: why a cell goes at a strength, if it does. Cells without matter that touch one that goes go with it:
    /// they may hold its rim.
    #[must_use]
    pub fn removed(&self, strength: Strength) -> Vec<Option<Reason>> {
        let mut all = vec![None; self.cells.count()];
        for (&cell, reason) in self.parts.iter().zip(self.cleaned.removed(strength)) {
            if reason.is_some() {
                all[cell] = reason;
                self.cells.beside(cell).filter(|&near| self.is_thin[near]).for_each(|near| all[near] = reason);
            }
        }
        all
    }
}

impl Clean<'_> {
    /// Finds which of `cells` of a volume go at each strength.
    ///
    /// # Errors
    /// If there is no camera, if masks are not those of the cameras, if the model has no density, if nothing would be
    /// left at any strength, or [`Error::Interrupted`].
    pub fn volume(&self, model: &dyn Model, cells: Cells) -> Result<CleanedVolume> {
        self.check_cameras()?;
        let field = model.field().ok_or_else(|| Error::setting("model", "a volume", model.kind()))?;
        let renderer = model.for_images(&RaySettings::for_images(), self.monitor)?;
        let stride = stride_for(self.cameras.iter().map(Camera::pixels).sum(), self.pixels);
        let pixels =
            Views { cameras: self.cameras, masks: self.masks, pixel_offset: self.pixel_offset, stride, every: 1 };
        let mut views: Vec<ListedView> = Vec::new();
        list_cells(&pixels, &*renderer, cells, self, |view| views.push(view))?;

        let mut is_part = vec![false; cells.count()];
        views.iter().flat_map(|view| &view.rows).flat_map(ListedRow::hits).for_each(|hit| {
            is_part[hit.part as usize] = true;
        });
        let others: Vec<usize> = (0..cells.count()).filter(|&i| !is_part[i]).collect();
        let is_in_image = |x: Vec3| self.cameras.iter().any(|camera| camera.project_inside(x.as_dvec3()).is_some());
        let densities = densities(field, &others, cells);
        let mut is_thin = vec![false; cells.count()];
        for (&cell, density) in others.iter().zip(densities) {
            is_thin[cell] = f64::from(density) * cells.edge(cell) < LEAST_MATTER;
        }
        // Matter that no camera has in its image.
        let unseen = others.into_par_iter().filter(|&cell| !is_thin[cell] && !is_in_image(cells.center(cell)));
        let unseen: Vec<usize> = unseen.collect();
        unseen.iter().for_each(|&cell| is_part[cell] = true);
        if self.hidden {
            (0..cells.count()).for_each(|cell| is_part[cell] |= !is_thin[cell]);
        }
        let parts: Vec<usize> = (0..cells.count()).filter(|&i| is_part[i]).collect();
        let mut number = vec![0; cells.count()];
        parts.iter().enumerate().for_each(|(i, &cell)| number[cell] = i as u32);
        let rows = views.par_iter_mut().flat_map(|view| &mut view.rows);
        rows.for_each(|row| row.hits_mut().iter_mut().for_each(|hit| hit.part = number[hit.part as usize]));

        let centers: Vec<Vec3> = parts.iter().map(|&cell| cells.center(cell)).collect();
        let reach: Vec<f32> = parts.iter().map(|&cell| (self.rule.of_cells.reach * cells.edge(cell)) as f32).collect();
        // What is inside of objects is hidden as well: only what is in no image at all goes unseen.
        let may_be_shown = parts.iter().map(|cell| unseen.binary_search(cell).is_err()).collect();
        let parts_at = Parts { centers: &centers, reach: &reach, by_window: true };
        let clean = Self { rule: Rule { on: self.rule.of_cells.on, ..self.rule }, ..*self };
        let cleaned = clean.decide(&Listing { views, parts: parts_at, opacities: Vec::new(), may_be_shown })?;
        Ok(CleanedVolume { cells, parts, cleaned, is_thin })
    }
}

/// Densities at the middles of cells.
fn densities(field: &dyn octobayes::field::RadianceField, chosen: &[usize], cells: Cells) -> Vec<f32> {
    const AT_ONCE: usize = 1 << 14;
    let of_some = |chosen: &[usize]| {
        let centers: Vec<Vec3> = chosen.iter().map(|&cell| cells.center(cell)).collect();
        let mut found = vec![0.0; centers.len()];
        field.densities(&centers, &mut found);
        found
    };
    chosen.par_chunks(AT_ONCE).flat_map_iter(of_some).collect()
}

/// Lists what rays meet in each cell, in the views that they belong to.
fn list_cells(
    views: &Views,
    renderer: &dyn Renderer,
    cells: Cells,
    clean: &Clean,
    take: impl FnMut(ListedView),
) -> Result<()> {
    let prepare = |camera: &Camera| {
        let camera = *camera;
        move |points: &[[f64; 2]], listed: &mut ListedPoints| {
            let found = renderer.weighted(&[(camera, points.to_vec())], clean.monitor)?;
            for (ray, &[x, y]) in points.iter().enumerate() {
                if found.is_dropped[ray] {
                    listed.push_unknown();
                    continue;
                }
                let ray_of = camera.ray(x, y);
                // Depths are along the view axis.
                let slant = camera.project(ray_of.at(1.0)).map_or(1.0, |(_, depth)| depth);
                let range = found.samples(ray);
                let samples = range.map(|i| (found.positions[i], found.weights[i], found.t[i]));
                listed.push(met(samples, cells, slant));
            }
            Ok(())
        }
    };
    views.list(clean.monitor, prepare, take)
}

/// What a ray meets in each cell, from its samples: position, share of the light, distance.
fn met(samples: impl Iterator<Item = (Vec3, f64, f64)>, cells: Cells, slant: f64) -> Vec<Listed> {
    let mut met: Vec<Listed> = Vec::new();
    // The cell that the ray is in, the light before it, its share of the light, and Σ w t.
    let mut latest: Option<(usize, f64, f64, f64)> = None;
    let mut light = 1.0;
    let mut end = |latest: Option<(usize, f64, f64, f64)>| {
        let Some((cell, before, weight, moment)) = latest else { return };
        let alpha = weight / before;
        if alpha >= LEAST_ALPHA {
            let depth = (slant * moment / weight) as f32;
            met.push(Listed { part: cell as u32, alpha: alpha.min(1.0) as f32, depth });
        }
    };
    for (x, weight, t) in samples {
        let Some(cell) = cells.around(x).filter(|_| weight > 0.0 && light > 0.0) else { continue };
        latest = match latest {
            Some((same, before, sum, moment)) if same == cell => {
                Some((cell, before, sum + weight, moment + weight * t))
            }
            ended => {
                end(ended);
                Some((cell, light, weight, weight * t))
            }
        };
        light -= weight;
    }
    end(latest);
    met
}

#[cfg(test)]
mod tests;
