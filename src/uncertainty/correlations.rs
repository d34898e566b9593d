//! Displacements of all vertices, drawn together: with them, errors of depth know that neighbours move together.
//!
//! The rest of a field takes vertices for independent. That makes a ray's depth too certain where the same training
//! rays pin several vertices together, but none of them by itself (Goli et al. 2024, section 6).

use glam::DVec3;

use super::UncertaintyField;
#[cfg(feature = "correlations")]
use crate::posterior::{DrawnPosterior, Scale};

/// Draws of the displacements of all vertices from their common posterior.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlations {
    draws: usize,
    /// `[vertices][3][draws]`: displacements along x, y and z, scene units. Exactly zero in all draws where no ray
    /// touched the vertex, which only the prior holds.
    displacements: Vec<f32>,
}

impl Correlations {
    /// Numbers of draws that a file may hold.
    const DRAWS: std::ops::RangeInclusive<usize> = 2..=1024;

    /// Checks displacements read from a file; otherwise says what was expected and found.
    pub(super) fn from_file(displacements: Vec<f32>, vertices: u64) -> Result<Self, (String, String)> {
        let (n, each) = (displacements.len(), usize::try_from(3 * vertices).unwrap_or(usize::MAX));
        let draws = n / each.max(1);
        if each.checked_mul(draws) != Some(n) || !Self::DRAWS.contains(&draws) {
            let expected = format!("{each} displacements for each of {} to {} draws", 2, Self::DRAWS.end());
            return Err((expected, format!("{n}")));
        }
        match displacements.iter().find(|u| !u.is_finite()) {
            Some(u) => Err(("finite displacements".into(), u.to_string())),
            None => Ok(Self { draws, displacements }),
        }
    }

    /// Number of draws n: variances have a relative error of √(2/n).
    #[must_use]
    pub fn draws(&self) -> usize {
        self.draws
    }

    /// As in a file.
    pub(super) fn displacements(&self) -> &[f32] {
        &self.displacements
    }

    pub(super) fn memory(&self) -> usize {
        self.displacements.capacity() * size_of::<f32>()
    }

    /// Adds what moves with vertex `v` in each draw, g being a gradient with respect to its displacement. False if no
    /// ray touched the vertex.
    pub(super) fn add(&self, v: usize, g: DVec3, moved: &mut [f64]) -> bool {
        let own = &self.displacements[3 * self.draws * v..][..3 * self.draws];
        for (u, g) in own.chunks(self.draws).zip(g.to_array()) {
            moved.iter_mut().zip(u).for_each(|(moved, &u)| *moved += g * f64::from(u));
        }
        own.iter().any(|u| *u != 0.0)
    }
}

impl UncertaintyField {
    /// The same field with draws from the whole posterior of its displacements, which
    /// [`depth_posterior`](UncertaintyField::depth_posterior) prefers to the vertices' own covariances. U stays as it
    /// is.
    ///
    /// # Errors
    /// If the field is not in the scale of its data with the prior of the draws, has another lattice, is a part of a
    /// run, or has leaves that are limited.
    #[cfg(feature = "correlations")]
    pub fn with_correlations(self, drawn: &DrawnPosterior) -> crate::Result<Self> {
        let wrong = |expected: &str, found: &str| Err(crate::Error::setting("correlations", expected, found));
        match self.protocol.scale {
            Scale::Data(scale) if scale.prior_deviation == drawn.prior_deviation() => {}
            _ => return wrong("a field in the scale of its data, with the prior of the draws", "another"),
        }
        if self.lattice != *drawn.lattice() {
            return wrong("draws on the field's lattice", "another");
        }
        if self.is_part() || !self.limits.is_unlimited() {
            return wrong("a whole run, with leaves as fine as its level", "a part, or limited leaves");
        }
        let draws = drawn.draws();
        let mut displacements = vec![0.0; 3 * draws * self.deviations.len()];
        for (point, own) in drawn.displacements() {
            let Some(v) = self.vertex_at(point) else { continue };
            displacements[3 * draws * v..].iter_mut().zip(own).for_each(|(to, &from)| *to = from as f32);
        }
        Ok(Self { correlations: Some(Correlations { draws, displacements }), conformal: None, ..self })
    }

    /// Draws from the whole posterior of the displacements, if there are any.
    #[must_use]
    pub fn correlations(&self) -> Option<&Correlations> {
        self.correlations.as_ref()
    }
}

#[cfg(test)]
#[cfg(feature = "correlations")]
mod tests {
    use super::*;
    use crate::estimate::{Estimation, GridKind, GridSettings, RaySettings};
    use crate::field::{ClosedForm, RadianceField};
    use crate::geometry::Domain;
    use crate::monitor::Silent;
    use crate::posterior::{Covariance, DataScale, Draws, FullPosterior, Posterior};
    use crate::render::{DepthSample, DepthVariance};
    use glam::Vec3;

    const DRAWS: Draws = Draws { number: 1000, seed: 1, residual: 1e-6, iterations: 2000 };

    /// A field of the courtyard, and the posterior of the same rays with all correlations.
    fn field(grid: GridKind, level: u8) -> (UncertaintyField, FullPosterior, DataScale, u64) {
        let scene = ClosedForm::courtyard();
        let cameras = ClosedForm::half_circle(5, [40, 40]);
        let domain = Domain::Box(scene.bounds());
        let scale = DataScale::from_cameras(&cameras, 0.05, &domain).unwrap();
        // Every vertex that any ray touched.
        let grid = GridSettings { grid, tolerance: 0.0, scale: Scale::Data(scale), ..GridSettings::default() };
        let grid = grid.level(level).covariance(Covariance::Block).keep_sums(true);
        let mut full = FullPosterior::new(grid.lattice(domain).unwrap());
        let rays = RaySettings::default().rays(2000).occupancy(32);
        let estimation = Estimation::new(&scene, &cameras).rays(rays).grid(grid);
        let outcome = estimation.tap(|batches| {
            full.add(batches);
            Ok(())
        });
        let outcome = outcome.run().unwrap();
        (outcome.field, full, scale, outcome.progress.rays)
    }

    /// A ray along x whose depth answers to what it meets.
    fn depth(y: f32, z: f32) -> Vec<DepthSample> {
        let sample = |i: i32| {
            let position = Vec3::new(0.07 * i as f32, y, z);
            DepthSample { position, gradient: DVec3::new(0.3, -0.1, 0.05) / f64::from(1 + i.abs()) }
        };
        (-8..=8).map(sample).collect()
    }

    #[test]
    fn depth_varies_as_the_whole_posterior_says() {
        for grid in [GridKind::Octree, GridKind::Dense] {
            let (field, full, scale, rays) = field(grid, 3);
            let exact = full.exact(rays, scale).unwrap();
            let drawn = full.draw(rays, scale, DRAWS, &Silent).unwrap();
            let joined = field.clone().with_correlations(&drawn).unwrap();
            assert_eq!(joined.correlations().unwrap().draws(), 1000);
            let mut most = 0.0_f64;
            for (y, z) in [(-0.6, -0.8), (-0.2, -0.6), (0.0, 0.0), (0.3, -0.7), (0.7, 0.4)] {
                let ray = depth(y, z);
                let [alone, together] = [&field, &joined].map(|field| field.depth_posterior().unwrap().variance(&ray));
                // Displacements are rounded to f32, 6e-8 of each; what is summed may cancel to a hundredth.
                let full = drawn.variance(&ray);
                assert!((together - full).abs() < 1e-5 * full, "{grid:?}: {together} and {full}");
                // Five standard deviations of a variance by so many draws.
                let ratio = together / exact.variance(&ray);
                assert!((ratio - 1.0).abs() < 5.0 * (2.0 / 1000.0_f64).sqrt(), "{grid:?}: {ratio}");
                most = most.max(together / alone);
            }
            // Neighbours that the same rays pin are less certain than by themselves.
            assert!((1.3..100.0).contains(&most), "{most}");
            // Outside the box, and where no ray touched a vertex, the prior holds matter.
            let far = [DepthSample { position: Vec3::new(5.0, 0.0, 0.0), gradient: DVec3::X }];
            let variance = joined.depth_posterior().unwrap().variance(&far);
            assert!((variance / scale.prior_deviation.powi(2) - 1.0).abs() < 1e-6, "{variance}");
        }
    }

    #[test]
    fn they_stay_with_what_they_hold_for() {
        let (field, full, scale, rays) = field(GridKind::Octree, 3);
        let few = Draws { number: 4, ..DRAWS };
        let drawn = full.draw(rays, scale, few, &Silent).unwrap();
        let joined = field.clone().with_correlations(&drawn).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("joined.oct");
        joined.write(&path).unwrap();
        let read = UncertaintyField::read(&path).unwrap();
        assert_eq!(read.correlations(), joined.correlations());
        let variance = |field: &UncertaintyField| field.depth_posterior().unwrap().variance(&depth(0.3, -0.7));
        let before = variance(&read);
        assert_eq!(before, variance(&read.clone().without_sums()));
        assert_eq!(before, variance(&read.clone().with_covariance(Covariance::Trace).unwrap()));
        let surer = DataScale { prior_deviation: 0.5 * scale.prior_deviation, ..scale };
        let reread = read.with_data_scale(surer).unwrap();
        assert!(reread.correlations().is_none());
        // Draws with another prior, of another lattice, or for a field of no lengths.
        let said = |field: UncertaintyField| field.with_correlations(&drawn).unwrap_err().to_string();
        assert!(said(reread.clone()).contains("the prior of the draws"));
        assert!(said(reread.with_lambda(1.0e9).unwrap()).contains("the scale of its data"));
        let (_, coarse, ..) = self::field(GridKind::Octree, 2);
        let drawn = coarse.draw(rays, scale, few, &Silent).unwrap();
        assert!(field.with_correlations(&drawn).unwrap_err().to_string().contains("the field's lattice"));
    }

    #[test]
    fn files_are_not_believed() {
        let of = |n: usize, u: f32| Correlations::from_file(vec![u; n], 5).map(|found| found.draws());
        assert_eq!(of(30, 0.1), Ok(2));
        assert_eq!(of(31, 0.1).unwrap_err().1, "31");
        assert_eq!(of(15, 0.1).unwrap_err().0, "15 displacements for each of 2 to 1024 draws");
        assert_eq!(of(30, f32::NAN).unwrap_err(), ("finite displacements".into(), "NaN".into()));
        assert!(Correlations::from_file(vec![0.0; 4], 0).is_err());
    }
}
