//! Does U rank the depth error of lego's test views?

use std::path::Path;

use glam::DVec3;
use octobayes::Result;
use octobayes::geometry::Aabb;
use octobayes::monitor::Silent;
use octobayes::render::VolumeRenderer;
use octobayes_data::{DepthKind, Views};
use octobayes_evaluation::{
    DepthError, DepthFiles, DepthMeaning, EvaluatedView, Evaluator, Measure, Reading, Score, TrueView,
};
use serde::{Deserialize, Serialize};

use super::scenes::Scene;

/// Half edge of a box around lego, scene units.
const LEGO: f64 = 1.5;

/// Test views with true depth.
pub struct Truth {
    views: Vec<TrueView>,
}

/// How well one measure ranks the error, by all pixels together.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Rank {
    pub name: String,
    /// AUSE of the mean absolute error and of the RMSE.
    pub mae: f64,
    pub rmse: f64,
    /// The curve of mean absolute error: removed share, error left (scene units), and that of a perfect order.
    pub curve: Vec<[f64; 3]>,
}

/// What an evaluation found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Ranking {
    /// In the order of readings and their ray averages, then the measures without a Hessian.
    pub ranks: Vec<Rank>,
    pub depth: DepthError,
    /// Mean over views, dB.
    pub psnr: f64,
}

impl Truth {
    /// One in `every` of lego's 40 test views with a depth map, and of their pixels every `stride`-th along x and y.
    /// The depth maps have eight bits over eight scene units.
    pub fn lego(data: &Path, every: usize, stride: u32) -> Result<Self> {
        let folder = data.join("nerf-lego-400");
        let views = Views::read(&folder.join("transforms_test.json"), Some([400, 400]))?;
        let (maps, pattern) = (Some(folder.join("test")), "{}_depth_0001.png".into());
        let depth = DepthFiles { folder: maps, pattern, scale: Some([8.0, -8.0]), kind: DepthKind::Euclidean };
        let found = depth.find(&views.path, &views.frames, &views.frames)?;
        let depth = DepthMeaning { encoding: found.encoding, bounds: Aabb::centered_cube(LEGO), jump: 0.0 };
        let frames = found.frames.iter().step_by(every);
        let views =
            frames.map(|frame| TrueView::read(frame, Some(&depth), DVec3::ONE, 0.5, stride)).collect::<Result<_>>()?;
        Ok(Self { views })
    }

    /// Number of views.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// Ranks the depth error of a scene's model by these readings.
    pub fn rank(&self, scene: &Scene, readings: &[Reading]) -> Result<Ranking> {
        let tracer = scene.settings.cutoff(1e-4).tracer(&*scene.field, 0.0, &Silent)?;
        let model = VolumeRenderer { tracer, differentiation: None };
        let evaluator = Evaluator::new(&model, readings);
        let views: Vec<EvaluatedView> = (0..)
            .zip(&self.views)
            .map(|(seed, truth)| evaluator.evaluate(truth, seed, &Silent))
            .collect::<Result<_>>()?;
        let name = |measure| match measure {
            Measure::Reading(i, average) => format!("{}, {}", readings[i].name, average.name()),
            other => evaluator.name(other),
        };
        let rank = |(m, measure)| {
            let score = Score::new(&views, m).expect("pixels with depth and some error");
            let curve = &score.curves[0];
            let left = curve.removed.iter().zip(&curve.by_uncertainty).zip(&curve.by_error);
            let curve = left.map(|((&r, &u), &e)| [r, u * curve.largest, e * curve.largest]).collect();
            Rank { name: name(measure), mae: score.ause_pooled.mae, rmse: score.ause_pooled.rmse, curve }
        };
        Ok(Ranking {
            ranks: evaluator.measures().into_iter().enumerate().map(rank).collect(),
            depth: DepthError::new(&views).expect("pixels with depth"),
            psnr: views.iter().map(|view| view.psnr).sum::<f64>() / views.len() as f64,
        })
    }
}
