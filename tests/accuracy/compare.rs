//! The pipeline against the oracle, on the same rays.

use glam::{DMat3, DVec3};
use octobayes::Result;
use octobayes::estimate::{Estimation, GridKind, GridSettings, Outcome, RaySettings};
use octobayes::field::{RadianceField, TrainedField};
use octobayes::geometry::Camera;
use octobayes::posterior::{Covariance, VertexSums};
use octobayes::rays::{PixelSample, RunProgress};
use octobayes::uncertainty::UncertaintyField;

use crate::oracle::ground::Ground;
use crate::oracle::{Derivatives, Oracle, Sums, hessian, readings};
use crate::scenes::Specimen;

/// A specimen, its cameras, and the settings to look at it.
pub struct Case<'a> {
    pub field: &'a Specimen,
    pub cameras: &'a [Camera],
    pub level: u8,
    pub rays: u64,
}

/// What came out of the pipeline, and what the oracle needs to follow its rays.
pub struct Run {
    pub field: UncertaintyField,
    pub progress: RunProgress,
    pub picks: Vec<PixelSample>,
    /// Half the width h of the differences.
    pub h: DVec3,
}

/// Settings that leave nothing out: every sample of every ray is differentiated.
pub fn nothing_left_out(rays: RaySettings, grid: GridSettings) -> (RaySettings, GridSettings) {
    (rays.cutoff(0.0), grid.tolerance(0.0))
}

impl Case<'_> {
    /// The program's defaults, on a dense grid.
    pub fn defaults(&self) -> (RaySettings, GridSettings) {
        let rays = RaySettings::default().rays(self.rays).occupancy(48);
        (rays, GridSettings::default().grid(GridKind::Dense).level(self.level))
    }

    /// Runs the pipeline.
    pub fn run(&self, settings: (RaySettings, GridSettings)) -> Result<Run> {
        self.run_through(self.field, settings)
    }

    /// Runs the pipeline on a field with the same values.
    pub fn run_through(&self, field: &dyn TrainedField, (rays, grid): (RaySettings, GridSettings)) -> Result<Run> {
        let run = Estimation::new(&field, self.cameras).rays(rays).grid(grid).prepare()?;
        let picks = run.stream().pixels.picks(0, rays.rays);
        let h = run.stream().source.marched().unwrap().difference_step();
        let Outcome { field, progress, .. } = run.finish()?;
        Ok(Run { field, progress, picks, h })
    }

    /// The oracle on the rays of a run.
    pub fn oracle(&self, run: &Run, derivatives: Derivatives) -> Sums {
        let ground = Ground::of(self.field);
        let oracle = Oracle {
            ground: &ground,
            cameras: self.cameras,
            interval: self.field.suggested_step(),
            background: DVec3::ONE,
            derivatives,
            cells: 1 << self.level,
        };
        oracle.sums(&run.picks)
    }
}

/// The cameras that a specimen brings.
pub fn cameras(field: &Specimen) -> Vec<Camera> {
    field.training_cameras()
}

/// The paper's 1e-4 / M³ per squared longest edge.
pub fn lambda(field: &Specimen, level: u8) -> f64 {
    let edge = (field.bounds().max() - field.bounds().min()).max_element();
    1e-4 / f64::from(1_u32 << level).powi(3) / (edge * edge)
}

fn matrix(sums: &VertexSums) -> DMat3 {
    let [xx, xy, xz, yy, yz, zz] = sums.information;
    DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
}

/// How far apart two fields are, over all (M + 1)³ vertices, none left out.
#[derive(Debug, Clone, Copy, Default)]
pub struct Error {
    /// max ‖ΔH‖ / ‖H‖, Frobenius norm.
    pub hessian: f64,
    /// max |Δ log10 U| of `diagonal`, `trace`, `block`.
    pub largest: [f64; 3],
    /// Mean |Δ log10 U| of the same, over the vertices whose `trace` was moved by more than a tenth of a decade in
    /// either run.
    pub mean: [f64; 3],
    /// Mean of Δ log10 U (pipeline − oracle) over these vertices.
    pub bias: [f64; 3],
    /// Number of these vertices.
    pub moved: usize,
}

impl Error {
    /// Mean and maximum of |Δ log10 U| of the worst reading of each.
    pub fn worst(&self) -> [f64; 2] {
        [self.mean, self.largest].map(|readings| readings.into_iter().fold(0.0, f64::max))
    }
}

/// Compares a run with the oracle's sums over the same rays.
pub fn error(case: &Case, run: &Run, truth: &Sums) -> Error {
    let (rays, lambda) = (run.picks.len() as u64, lambda(case.field, case.level));
    let sums = run.field.sums().expect("it was kept");
    assert_eq!(sums.len(), truth.information.len());
    let mut error = Error::default();
    let prior = readings(&DMat3::ZERO, rays, lambda)[1].log10();
    for (found, truth) in sums.iter().zip(&truth.information) {
        let (a, b) = (hessian(&matrix(found), rays, lambda), hessian(truth, rays, lambda));
        let norm = |m: DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        // Taking a maximum would skip NaN.
        assert!(norm(a).is_finite() && norm(b).is_finite(), "{a} against {b}");
        error.hessian = error.hessian.max(norm(a - b) / norm(b));
        let exact = readings(truth, rays, lambda);
        let deviations = [Covariance::Diagonal, Covariance::Trace, Covariance::Block]
            .map(|covariance| covariance.deviation(found, rays, run.field.record().lambda));
        let moved = exact[1].min(deviations[1]).log10() < prior - 0.1;
        error.moved += usize::from(moved);
        for k in 0..3 {
            let change = deviations[k].log10() - exact[k].log10();
            error.largest[k] = error.largest[k].max(change.abs());
            error.mean[k] += if moved { change.abs() } else { 0.0 };
            error.bias[k] += if moved { change } else { 0.0 };
        }
    }
    let n = error.moved.max(1) as f64;
    Error { mean: error.mean.map(|sum| sum / n), bias: error.bias.map(|sum| sum / n), ..error }
}
