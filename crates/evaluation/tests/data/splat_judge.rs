//! `evaluate` on splats of lego, trained on 12 views: how well U ranks the depth of new views.

use std::path::Path;

use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes_data::{Selection, Views};
use octobayes_evaluation::{Evaluation, Reading, Report};
use octobayes_splats::Splats;

use super::data;

#[path = "../../../../experiments/src/halved.rs"]
mod halved;

fn judge(splats: &Splats, cameras: &[Camera], level: u8, folder: &Path) -> Report {
    let domain = Domain::Box(Aabb::centered_cube(1.4));
    let pixels = cameras.iter().map(Camera::pixels).sum();
    let scale = DataScale::new(pixels, 0.03, DataScale::default_prior_deviation(&domain)).unwrap();
    let grid = GridSettings::default().level(level).covariance(Covariance::Block).scale(Scale::Data(scale));
    let run = Estimation::new(splats, cameras).domain(domain).grid(grid.keep_sums(true));
    let field = run.rays(RaySettings::default().rays(1_000_000)).run().unwrap().field;
    let readings = Reading::from_field("lego", &field, Some(&[Covariance::Block]), None).unwrap();
    let cameras = folder.join("transforms_test.json");
    let views = Views::read(&cameras, None).unwrap();
    let evaluation = Evaluation {
        model: splats,
        name: "lego".into(),
        settings: RaySettings::for_images(),
        readings: &readings,
        ensemble: Vec::new(),
        cameras,
        selection: Selection::All,
        stride: 1,
        depth: halved::depth(folder),
        object_masks: None,
        training_depth: None,
        images: None,
        calibrate: Some(0.9),
        clean_up: false,
        curves: false,
    };
    evaluation.prepare(views).unwrap().judge(&Silent, &mut |_| ()).unwrap().report
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/splats-trained and nerf-lego-400"]
fn evaluate_ranks_the_depth_of_splats() {
    let folder = tempfile::tempdir().unwrap();
    halved::write(&data("nerf-lego-400"), folder.path()).unwrap();
    // 12 views of one side: 22.0 dB at this size, and an area of 0.166 at level 5 (`experiments/splats.md`).
    let name = "lego_half12_6k_sh2";
    let splats = Splats::read(&data(&format!("splats-trained/{name}.ply"))).unwrap();
    let cameras = Views::read(&data(&format!("splats-trained/{name}_transforms.json")), None).unwrap().cameras();
    let report = judge(&splats, &cameras, 5, folder.path());
    let area = |wanted: &str| {
        let row = report.scored().find(|row| row.name == wanted);
        row.unwrap_or_else(|| panic!("{wanted}")).score.ause_pooled.mae
    };
    assert!((21.5..22.5).contains(&report.psnr), "{} dB", report.psnr);
    let ours = area("lego block");
    assert!((0.156..0.176).contains(&ours), "{ours}");
    assert!(ours < area("ray-weight variance"), "{ours}");
    let held = report.calibrated.unwrap().left_out;
    assert!(held[0] > 0.7 && (held[1] - 0.9).abs() < 0.03, "{held:?}");
}
