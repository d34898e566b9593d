//! Training on real images, which the repository does not ship: `OCTOBAYES_DATA` names their folder.

use std::path::PathBuf;

use glam::Vec3;
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes_train::{
    DatasetFiles, Shot, SplatOrigin, SplatSettings, SplatTrainer, TrainSettings, Trainer, Training, quality,
};

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-lego-400"]
fn a_short_training_on_data_of_lego_reaches_the_measured_quality() {
    let files = DatasetFiles::read(&data("nerf-lego-400")).unwrap();
    let [shots, held_out] = files.load(&Silent).unwrap();
    assert_eq!((shots.len(), held_out.len(), files.missing), (100, 40, 0));
    let mut trainer = Trainer::new(TrainSettings::default(), Domain::Box(files.bounds), &shots).unwrap();
    for step in 0..300 {
        trainer.step(f64::from(step) / 300.0);
    }
    let quality = quality(&trainer.field(serde_json::Value::Null), &held_out, Vec3::ONE, 50_000).unwrap();
    // 20.07 dB were measured after these 300 steps. Half a decibel is allowed for processors that round expm1
    // otherwise.
    assert!((quality.psnr - 20.07).abs() < 0.5, "{quality:?}");
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/nerf-lego-400"]
fn splats_trained_on_data_of_lego_reach_the_measured_quality() {
    let files = DatasetFiles::read(&data("nerf-lego-400")).unwrap();
    let half =
        |shots: Vec<Shot>| -> Vec<Shot> { shots.into_iter().map(|shot| shot.shrunk([200; 2]).unwrap()).collect() };
    let [shots, held_out] = files.load(&Silent).unwrap().map(half);
    assert_eq!(SplatSettings::most_for(&shots), 15_000);
    // A sixth of them is enough to be compared with what was measured.
    let settings = SplatSettings::default().most(2_500);
    let mut trainer = SplatTrainer::new(settings, files.bounds, &[], &shots).unwrap();
    assert_eq!(trainer.origin(), SplatOrigin::Hull);
    for step in 0..3000 {
        trainer.step(f64::from(step) / 3000.0);
    }
    assert_eq!(trainer.len(), 2_500);
    let psnr = trainer.look(&held_out, usize::MAX, None).unwrap().psnr;
    // 26.91 dB were measured, after 11 s of two cores; all 15,000 and 4,000 steps reach 31.06 dB in 67 s of one. Other
    // processors round exp and ln otherwise, and a run leads elsewhere from there.
    assert!((psnr - 26.91).abs() < 0.3, "{psnr}");
}
