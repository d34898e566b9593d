//! Does U rank the depth error, and does that change with the rays?

use std::path::Path;

use glam::DVec3;
use octobayes::Result;
use octobayes::dataset::{DepthEncoding, DepthKind, Views};
use octobayes::evaluate::{DepthFiles, Evaluator, Reading, Score, TrueView};
use octobayes::metrics::ErrorKind;
use octobayes::monitor::Silent;
use octobayes::render::RayAverage;
use octobayes::uncertainty::UncertaintyField;

use super::scenes::Scene;

/// Every so many of the 200 test views, and every so many pixels of both axes.
const EVERY: usize = 25;
const STRIDE: u32 = 2;

/// Test views with true depth.
pub struct Truth {
    views: Vec<TrueView>,
}

impl Truth {
    /// Those of lego; the depth maps have eight bits.
    pub fn lego(data: &Path) -> Result<Self> {
        let folder = data.join("nerf-lego-400");
        let views = Views::read(&folder.join("transforms_test.json"), Some([400, 400]))?;
        let encoding = DepthEncoding { offset: 8.0, scale: -8.0, kind: DepthKind::Euclidean };
        let depth = DepthFiles { folder: folder.join("test"), pattern: "{}_depth_0001.png".into(), encoding };
        let frames = views.frames.iter().step_by(EVERY);
        let views =
            frames.map(|frame| TrueView::read(frame, &depth, DVec3::ONE, 0.5, STRIDE)).collect::<Result<_>>()?;
        Ok(Self { views })
    }

    /// AUSE (MAE) of a field; the scene's colours do not depend on it.
    pub fn ause(&self, scene: &Scene, field: &UncertaintyField) -> Result<f64> {
        let tracer = scene.settings.cutoff(1e-4).tracer(&*scene.field, 0.0, &Silent)?;
        let readings = [Reading { name: "U".into(), field: field.clone(), blends: vec![RayAverage::WeightedMean] }];
        let evaluator = Evaluator { tracer, readings: &readings, members: Vec::new() };
        let judged: Vec<_> = (0..)
            .zip(&self.views)
            .map(|(seed, truth)| evaluator.evaluate(truth, seed, &Silent))
            .collect::<Result<_>>()?;
        Ok(Score::of(&judged, 0).map_or(f64::NAN, |score| score.area(ErrorKind::Mae)))
    }
}
