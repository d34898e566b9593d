//! The lattice of a volume: cubes in folded space, in bricks.
//!
//! Folded space is scene space, except that a contracted domain is folded to a cube: the ball around its centre is as
//! it is, the rest of space lies around it, up to twice the radius.

use glam::{DVec3, Vec3};

use octobayes::geometry::{Aabb, Domain, Lattice};

/// Cells along each axis of a brick. Its eight samples along each axis include those on its faces, which neighbours
/// repeat: interpolation then never leaves a brick.
pub const CELLS: u32 = 7;
/// Samples along each axis of a brick.
pub const SIDE: usize = CELLS as usize + 1;
/// Samples of a brick.
pub const SAMPLES: usize = SIDE * SIDE * SIDE;

/// Of what is stored at every other sample along each axis.
pub const COARSE: usize = (SIDE / 2).pow(3);

/// A lattice of cubes.
#[derive(Debug, Clone)]
pub struct Grid {
    /// What is folded, and how.
    pub domain: Domain,
    /// Where the model may have density.
    pub bounds: Aabb,
    /// Lower corner in folded space.
    pub origin: DVec3,
    /// Edge of a cell in folded space.
    pub edge: f64,
    /// Bricks along each axis.
    pub bricks: [u32; 3],
}

impl Grid {
    /// A lattice of `cells` along the longest edge: over `bounds`, or over all of space if the `field`'s domain does.
    pub fn new(bounds: Aabb, field: &Domain, cells: u32) -> Self {
        let (domain, low, size) = match field {
            Domain::Contracted { center, radius, .. } => {
                (*field, DVec3::from(*center) - 2.0 * *radius, DVec3::splat(4.0 * *radius))
            }
            _ => (Domain::Box(bounds), bounds.min(), bounds.size()),
        };
        let edge = size.max_element() / f64::from(cells);
        let bricks = (size / (edge * f64::from(CELLS))).to_array().map(|n| ((n - 1e-6).ceil() as u32).max(1));
        Self { domain, bounds, origin: low, edge, bricks }
    }

    /// Scene position of lattice coordinates; `None` where there can be no density.
    pub fn position(&self, at: DVec3) -> Option<Vec3> {
        let folded = self.origin + self.edge * at;
        let x = match &self.domain {
            Domain::Contracted { center, radius, .. } => {
                let unit = (folded - DVec3::from(*center)) / (4.0 * *radius) + 0.5;
                let is_inside = unit.cmpge(DVec3::ZERO).all() && unit.cmple(DVec3::ONE).all();
                is_inside.then(|| self.domain.to_scene(unit))?
            }
            _ => folded,
        };
        Some(x.as_vec3()).filter(|x| self.bounds.contains(*x))
    }

    /// True if every vertex of a field's lattice is a sample, so that what the field interpolates can be interpolated.
    pub fn holds(&self, field: &Lattice) -> bool {
        let low = match field.domain() {
            Domain::Box(bounds) => bounds.min(),
            Domain::Contracted { center, radius, .. } => DVec3::from(*center) - 2.0 * *radius,
        };
        let apart = field.domain().size() / (f64::from(field.cells_per_axis()) * self.edge);
        let offset = (low - self.origin) / self.edge;
        let is_whole = |v: DVec3| (v - v.round()).abs().max_element() < 1e-6 * v.abs().max_element().max(1.0);
        is_whole(apart) && apart.min_element() > 0.5 && is_whole(offset)
    }

    /// Lattice coordinates of a scene position.
    pub fn folded(&self, x: DVec3) -> DVec3 {
        match &self.domain {
            Domain::Contracted { center, radius, norm } => {
                let y = (x - DVec3::from(*center)) / *radius;
                let r = norm.length(y);
                let k = if r > 1.0 { (2.0 - 1.0 / r) / r } else { 1.0 };
                (*radius * (k * y + 2.0)) / self.edge
            }
            _ => (x - self.origin) / self.edge,
        }
    }

    /// The same; `None` outside the lattice.
    pub fn lattice(&self, x: DVec3) -> Option<DVec3> {
        let at = self.folded(x);
        let last = DVec3::from(self.samples().map(|n| n as f64 - 1.0));
        (at.cmpge(DVec3::ZERO).all() && at.cmple(last).all()).then_some(at)
    }

    /// Samples along each axis.
    pub fn samples(&self) -> [usize; 3] {
        self.bricks.map(|n| (n * CELLS) as usize + 1)
    }

    /// Length that a cell's edge has in the scene around x.
    pub fn length(&self, x: Vec3) -> f64 {
        self.edge * self.domain.stretch(x)
    }

    /// True if space is as it is around x.
    pub fn is_plain(&self, x: Vec3) -> bool {
        self.domain.stretch(x) <= 1.0
    }

    /// The bricks in order, x fastest.
    pub fn all_bricks(&self) -> Vec<[u32; 3]> {
        let [nx, ny, nz] = self.bricks;
        (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z]))).collect()
    }
}

/// Lattice coordinates of sample `i` of a brick, x fastest.
pub fn sample(brick: [u32; 3], i: usize) -> DVec3 {
    let offset = place(i);
    DVec3::from([0, 1, 2].map(|axis| f64::from(brick[axis] * CELLS) + offset[axis] as f64))
}

/// Place of a sample in its brick.
pub fn place(i: usize) -> [usize; 3] {
    [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)]
}

/// A sample and those around it in its brick.
pub fn neighbours(i: usize) -> impl Iterator<Item = usize> {
    let [x, y, z] = place(i).map(|k| k.saturating_sub(1)..(k + 2).min(SIDE));
    z.flat_map(move |z| {
        let x = x.clone();
        y.clone().flat_map(move |y| x.clone().map(move |x| x + SIDE * (y + SIDE * z)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes::geometry::Norm;

    #[test]
    fn a_field_is_held_by_multiples_of_its_cells() {
        let bounds = Aabb::centered_cube(1.5);
        let field = Lattice::new(bounds, 5).unwrap();
        let holds = |cells| Grid::new(bounds, field.domain(), cells).holds(&field);
        assert!(holds(32) && holds(64) && holds(96));
        assert!(!holds(16) && !holds(48) && !holds(63));
        // Shifted by a third of a cell.
        let shifted = Aabb::new(bounds.min() + 0.01, bounds.max() + 0.01).unwrap();
        assert!(!Grid::new(shifted, field.domain(), 64).holds(&field));
        let domain = Domain::contracted(DVec3::new(0.3, 0.0, 1.0), 0.7, Norm::L2).unwrap();
        let field = Lattice::from_domain(domain, 6).unwrap();
        assert!(Grid::new(bounds, &domain, 256).holds(&field) && !Grid::new(bounds, &domain, 250).holds(&field));
    }

    #[test]
    fn folding_is_the_inverse_of_position() {
        let bounds = Aabb::centered_cube(9.0);
        for norm in [Norm::L2, Norm::Linf] {
            let domain = Domain::contracted(DVec3::new(0.3, 0.0, 1.0), 0.7, norm).unwrap();
            let grid = Grid::new(bounds, &domain, 64);
            for at in [DVec3::new(30.0, 31.5, 33.0), DVec3::new(12.0, 40.0, 29.0)] {
                let x = grid.position(at).unwrap();
                assert!((grid.lattice(x.as_dvec3()).unwrap() - at).length() < 1e-3, "{norm:?} {at}");
            }
        }
    }
}
