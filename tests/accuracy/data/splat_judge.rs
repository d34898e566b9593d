//! `evaluate` on splats of lego, trained on 100, 12 and 10 views: how well U ranks the depth of new views.

use std::path::{Path, PathBuf};

use image::{ImageBuffer, Luma, Rgba, RgbaImage};
use octobayes::dataset::{DepthKind, Selection, Views, write_transforms};
use octobayes::estimate::{Estimation, GridSettings, RaySettings, Subject};
use octobayes::evaluate::{DepthFiles, Evaluation, Reading, Report};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Covariance, DataScale, Scale};
use octobayes::splats::Splats;

const SIDE: u32 = 200;

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}

/// The held-out views at the size of the splats' training: means of 2 × 2 pixels, with depth where all four have some.
fn write_held_out(folder: &Path) {
    let views = Views::read(&data("nerf-lego-400/transforms_test.json"), None).unwrap();
    let mut cameras = Vec::new();
    for frame in &views.frames {
        let name = frame.name.trim_start_matches("./test/");
        let read = |path: String| image::open(data(&format!("nerf-lego-400/test/{path}.png"))).unwrap().into_rgba8();
        let (image, depth) = (read(name.into()), read(format!("{name}_depth_0001")));
        let four = |x: u32, y: u32| [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[i, j]| [2 * x + i, 2 * y + j]);
        let small = RgbaImage::from_fn(SIDE, SIDE, |x, y| {
            let pixels = four(x, y).map(|[x, y]| image.get_pixel(x, y).0.map(f64::from));
            let alpha: f64 = pixels.iter().map(|p| p[3]).sum();
            let mean = |k: usize| pixels.iter().map(|p| p[k] * p[3]).sum::<f64>() / alpha.max(1.0);
            Rgba([mean(0), mean(1), mean(2), alpha / 4.0].map(|v| v.round() as u8))
        });
        small.save(folder.join(format!("{name}.png"))).unwrap();
        let small: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_fn(SIDE, SIDE, |x, y| {
            let values = four(x, y).map(|[x, y]| depth.get_pixel(x, y).0[0]);
            let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / 4.0;
            Luma([if values.contains(&0) { 0 } else { (mean * 257.0).round() as u16 }])
        });
        small.save(folder.join(format!("{name}_depth.png"))).unwrap();
        cameras.push((name.to_string(), frame.camera.resized([SIDE; 2])));
    }
    write_transforms(&folder.join("transforms_test.json"), &cameras).unwrap();
}

fn judge(splats: &Splats, cameras: &[Camera], level: u8, folder: &Path) -> Report {
    let domain = Domain::Box(Aabb::centered_cube(1.4));
    let pixels = cameras.iter().map(Camera::pixels).sum();
    let scale = DataScale::new(pixels, 0.03, DataScale::default_prior_deviation(&domain)).unwrap();
    let grid = GridSettings::default().level(level).covariance(Covariance::Block).scale(Scale::Data(scale));
    let run = Estimation::of_splats(splats, cameras).domain(domain).grid(grid.keep_sums(true));
    let field = run.rays(RaySettings::default().rays(1_000_000)).run().unwrap().field;
    let readings = Reading::from_field("lego", &field, Some(&[Covariance::Block]), None).unwrap();
    let cameras = folder.join("transforms_test.json");
    let views = Views::read(&cameras, None).unwrap();
    let evaluation = Evaluation {
        model: Subject::Splats(splats),
        name: "lego".into(),
        settings: RaySettings::for_images(),
        readings: &readings,
        ensemble: Vec::new(),
        cameras,
        selection: Selection::All,
        stride: 1,
        depth: DepthFiles {
            folder: Some(folder.into()),
            pattern: "{}_depth.png".into(),
            scale: Some([8.0, -8.0]),
            kind: DepthKind::Euclidean,
        },
        training_depth: None,
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
    write_held_out(folder.path());
    // Model, its PSNR at this size less half a decibel, and what its areas were at levels 5 and 6, rounded up.
    let models = [
        ("lego_15k_sh3", 31.5, [0.28, 0.27]),
        ("lego_half12_6k_sh2", 21.5, [0.17, 0.18]),
        ("lego_10views_5k_sh2", 23.3, [0.26, 0.28]),
    ];
    for (name, least, most) in models {
        let splats = Splats::read(&data(&format!("splats-trained/{name}.ply"))).unwrap();
        let cameras = Views::read(&data(&format!("splats-trained/{name}_transforms.json")), None).unwrap().cameras();
        for (level, most) in [5, 6].into_iter().zip(most) {
            let report = judge(&splats, &cameras, level, folder.path());
            for row in report.scored() {
                let [all, rank] = [row.score.ause_pooled.mae, row.score.rank_correlation];
                println!("{name} level {level} {}: {all:.4}, {rank:.3}", row.name);
            }
            let area = |wanted: &str| {
                let row = report.scored().find(|row| row.name == wanted);
                row.unwrap_or_else(|| panic!("{wanted}")).score.ause_pooled.mae
            };
            assert!(report.psnr > least, "{name}: {} dB", report.psnr);
            let ours = area("lego block");
            assert!(ours <= most && ours < area("ray-weight variance") && ours < area("1 - opacity"), "{name}: {ours}");
            let held = report.calibrated.unwrap().left_out;
            assert!(held[0] > 0.7 && (held[1] - 0.9).abs() < 0.03, "{name}: {held:?}");
        }
    }
}
