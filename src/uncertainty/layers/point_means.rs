//! Means over the pixels of training images, on the vertices of a lattice.

use glam::Vec3;

use crate::geometry::Lattice;
use crate::octree::{corners, morton};

/// A mean, 0 or more, around each point.
#[derive(Debug, Clone, PartialEq)]
pub struct PointMeans {
    lattice: Lattice,
    /// Over all pixels.
    mean: f32,
    /// Vertices that some pixel showed, by the Morton code of their lattice point, ascending.
    points: Vec<u64>,
    /// `[points]`: mean around the vertex.
    means: Vec<f32>,
}

/// Their entry in the header of a field's file.
#[derive(Debug, Clone, Copy, serde::Serialize, serde::Deserialize)]
pub struct Head {
    level: u8,
    mean: f32,
}

impl PointMeans {
    /// From the mean at each vertex that a pixel showed, in any order, and that over all pixels.
    pub fn new(lattice: Lattice, mean: f64, means: impl IntoIterator<Item = ([u32; 3], f64)>) -> Self {
        let mut found: Vec<(u64, f32)> =
            means.into_iter().map(|(point, mean)| (morton::encode(point), mean as f32)).collect();
        found.sort_unstable_by_key(|(code, _)| *code);
        let (points, means) = found.into_iter().unzip();
        Self { lattice, mean: mean as f32, points, means }
    }

    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Over all pixels.
    pub fn mean(&self) -> f64 {
        f64::from(self.mean)
    }

    /// The means at the corners of the cell of a scene point, where they are known, with their trilinear weights; none
    /// outside.
    pub fn around(&self, x: Vec3) -> impl Iterator<Item = (Option<f64>, f64)> {
        let of = |point: [u32; 3]| {
            let found = self.points.binary_search(&morton::encode(point));
            found.ok().map(|i| f64::from(self.means[i]))
        };
        self.lattice.coordinates(x).into_iter().flat_map(move |u| {
            let (cell, offset) = self.lattice.cell(u);
            corners(cell, offset).into_iter().map(move |(point, share)| (of(point), share))
        })
    }

    pub fn head(&self) -> Head {
        Head { level: self.lattice.level(), mean: self.mean }
    }

    /// Morton codes and means, as files keep them.
    pub fn contents(&self) -> (&[u64], &[f32]) {
        (&self.points, &self.means)
    }

    /// Bytes on the heap, spare capacity included.
    pub fn memory(&self) -> usize {
        self.points.capacity() * size_of::<u64>() + self.means.capacity() * size_of::<f32>()
    }

    /// Checks the contents of a file, means of at most `largest` on this lattice; the error names what was expected and
    /// found.
    pub fn checked(
        lattice: Lattice,
        largest: f32,
        Head { level, mean }: Head,
        (points, means): (Vec<u64>, Vec<f32>),
    ) -> Result<Self, (String, String)> {
        if level != lattice.level() {
            return Err((format!("level {}", lattice.level()), format!("level {level}")));
        }
        let most = lattice.cells_per_axis();
        let is_inside = |code: &u64| {
            let point = morton::decode(*code);
            morton::encode(point) == *code && point.iter().all(|coordinate| *coordinate <= most)
        };
        if points.len() != means.len() {
            return Err((format!("a mean for each of {} vertices", points.len()), means.len().to_string()));
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(("vertices in ascending order".into(), format!("{} before {}", pair[0], pair[1])));
        }
        if let Some(code) = points.iter().find(|code| !is_inside(code)) {
            return Err((format!("lattice points of level {}", lattice.level()), format!("code {code}")));
        }
        if let Some(mean) = means.iter().chain([&mean]).find(|mean| !(0.0..=largest).contains(*mean)) {
            return Err((format!("means of squares, from 0 to {largest:e}"), mean.to_string()));
        }
        Ok(Self { lattice, mean, points, means })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn files_are_not_believed() {
        let lattice = Lattice::new(Aabb::centered_cube(1.0), 6).unwrap();
        let at = [[0, 0, 0], [3, 5, 4], [64, 64, 64]];
        let found = PointMeans::new(lattice, 0.01, at.map(|point| (point, 0.25)));
        let (head, (points, means)) = (found.head(), found.contents());
        let read = |head, points: &[u64], means: &[f32]| {
            PointMeans::checked(lattice, 0.5, head, (points.to_vec(), means.to_vec()))
        };
        assert_eq!(read(head, points, means).unwrap(), found);
        let with = |i: usize, code: u64| {
            let mut points = points.to_vec();
            points[i] = code;
            points
        };
        let with_mean = |mean: f32| [&means[1..], &[mean]].concat();
        for (head, points, means, expected) in [
            (Head { level: 5, ..head }, points.to_vec(), means.to_vec(), "level 6"),
            (Head { mean: f32::NAN, ..head }, points.to_vec(), means.to_vec(), "means of squares"),
            (head, points.to_vec(), means[1..].to_vec(), "a mean for each"),
            (head, with(0, points[1]), means.to_vec(), "vertices in ascending order"),
            (head, with(2, morton::encode([65, 0, 0])), means.to_vec(), "lattice points"),
            (head, with(2, u64::MAX), means.to_vec(), "lattice points"),
            (head, points.to_vec(), with_mean(-1.0), "means of squares"),
            (head, points.to_vec(), with_mean(f32::INFINITY), "means of squares"),
            (head, points.to_vec(), with_mean(0.5 + f32::EPSILON), "means of squares, from 0 to 5e-1"),
        ] {
            let (said, found) = read(head, &points, &means).unwrap_err();
            assert!(said.contains(expected), "{said}, found {found}");
        }
    }
}
