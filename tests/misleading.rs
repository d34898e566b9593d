//! Results that would be wrong or misleading are not given without a word.

use std::path::Path;
use std::process::Command;

use octobayes::dataset::write_transforms;
use octobayes::field::ClosedForm;
use octobayes::geometry::Camera;
use octobayes::internal::npz::NpzWriter;

/// Exit code, stdout and stderr.
fn run(folder: &Path, args: &str) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_octobayes"))
        .args(args.split_whitespace())
        .current_dir(folder)
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// What a command says on stderr.
fn said(folder: &Path, args: &str) -> String {
    let (code, _, said) = run(folder, args);
    assert_eq!(code, Some(0), "{args}: {said}");
    said
}

/// A folder with four cameras on a half circle.
fn desk() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_transforms(&folder.path().join("cameras.json"), &named(4)).unwrap();
    folder
}

fn named(count: u32) -> Vec<(String, Camera)> {
    let cameras = ClosedForm::half_circle(count, [32, 32]).into_iter().enumerate();
    cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect()
}

/// A voxel grid over [-1, 1]³ whose density is a function of the position.
fn voxels(path: &Path, density: impl Fn([f32; 3]) -> f32) {
    const N: u64 = 32;
    let at = |i: u64| -1.0 + 2.0 * i as f32 / (N - 1) as f32;
    let place = |i: u64| [at(i / (N * N)), at(i / N % N), at(i % N)];
    let mut npz = NpzWriter::create(path).unwrap();
    npz.array("box", &[2, 3], [-1.0_f32, -1.0, -1.0, 1.0, 1.0, 1.0]).unwrap();
    npz.array("density", &[N, N, N], (0..N * N * N).map(|i| density(place(i)))).unwrap();
    let stripes = |i: u64| place(i).map(|x| 0.5 + 0.4 * (9.0 * x).sin());
    npz.array("color", &[N, N, N, 3], (0..N * N * N).flat_map(stripes)).unwrap();
    npz.finish().unwrap();
}

fn length(x: [f32; 3]) -> f32 {
    x.iter().map(|x| x * x).sum::<f32>().sqrt()
}

const RUN: &str = "--cameras cameras.json --level 5 --rays 4000 --occupancy 32";

/// A plain grey picture is never off by more than one half.
#[test]
fn errors_of_colours_that_no_training_leaves_are_refused() {
    let desk = desk();
    for bad in ["--psnr 3", "--psnr -20", "--psnr 0.03", "--psnr 500", "--noise 0.7", "--noise -0.1", "--noise 1e-9"] {
        let args = format!("uncertainty scene:ball {RUN} --scale data {bad} -o x.oct");
        let (code, _, said) = run(desk.path(), &args);
        assert!(code == Some(2) && (said.contains("grey") || said.contains("8 bits")), "{bad}: {said}");
    }
    for good in ["--psnr 6.1", "--psnr 60", "--noise 0.5"] {
        said(desk.path(), &format!("uncertainty scene:ball {RUN} --scale data {good} -o x.oct"));
    }
}
