//! Files of Gaussian splats by other programs, and the cameras of trained ones, which the repository does not ship:
//! `OCTOBAYES_DATA` names their folder.

use std::path::{Path, PathBuf};

use glam::Vec3;
use octobayes_data::Views;
use octobayes_splats::{RenderMode, Splats};

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}

fn read(path: &Path) -> Splats {
    Splats::read(path).unwrap_or_else(|e| panic!("{e}"))
}

/// Counts and degrees as the programs that wrote the files state them.
#[test]
#[ignore = "needs OCTOBAYES_DATA/splats and splats-trained"]
fn every_file_of_the_data_is_read_whole() {
    for (name, count, degree) in [
        ("splats/armadillo_10k.splat", 10_000, 0),
        ("splats/spot_10k.splat", 10_000, 0),
        ("splats/stanford_bunny_10k.splat", 10_000, 0),
        ("splats/plant.splat", 113_648, 0),
        ("splats/minimal.splat", 4, 0),
        ("splats/biker.compressed.ply", 152_746, 0),
        ("splats/biker.spz", 152_746, 0),
        ("splats/minimal-raw.spz", 4, 0),
        ("splats/minimal-v2.spz", 4, 0),
        ("splats/minimal-v3.spz", 4, 0),
        ("splats/minimal-v4.spz", 4, 0),
        ("splats/sh3_iteration_7000.ply", 9_080, 3),
        ("splats-trained/lego_15k_sh3.ply", 14_973, 3),
        ("splats-trained/lego_10views_5k_sh2.ply", 5_467, 2),
        ("splats-trained/lego_half12_6k_sh2.ply", 5_917, 2),
        ("splats-trained/spot_half12_3k_sh1.ply", 3_222, 1),
    ] {
        let splats = read(&data(name));
        assert_eq!((splats.len(), splats.degree(), splats.mode()), (count, degree, RenderMode::Classic), "{name}");
        assert!(!splats.notes().iter().any(|note| note.contains("dropped")), "{name}: {:?}", splats.notes());
    }
}

/// One scene in two formats, splat by splat. The steps are those of `.spz`, and for scales the chunk's of the other.
#[test]
#[ignore = "needs OCTOBAYES_DATA/splats"]
fn one_scene_in_two_formats_is_the_same_in_data_of_playcanvas() {
    let [a, b] = ["biker.spz", "biker.compressed.ply"].map(|name| read(&data("splats").join(name)));
    assert_eq!(a.len(), b.len());
    let mut largest = [0.0_f32; 4];
    let mut larger = |k: usize, found: f32| largest[k] = largest[k].max(found);
    for i in 0..a.len() {
        larger(0, (a.mean(i) - b.mean(i)).abs().max_element());
        // Scales below e^-10 do not exist in `.spz`.
        let floor = Vec3::splat(-10.0);
        larger(1, (a.log_scales()[i].max(floor) - b.log_scales()[i].max(floor)).abs().max_element());
        larger(2, (0..3).map(|c| (a.sh(i)[c] - b.sh(i)[c]).abs()).fold(0.0, f32::max));
        larger(3, (a.opacity(i) - b.opacity(i)).abs());
        // 2 asin(√(|Δq|²) / 2): q and −q are one rotation.
        let [p, q] = [&a, &b].map(|splats| splats.rotation(i));
        let apart = (p - q).length().min((p + q).length());
        assert!(apart < 0.006, "splat {i}: {p} {q}");
    }
    let [mean, scale, color, opacity] = largest;
    println!("largest differences: means {mean}, log scales {scale}, colours {color}, opacities {opacity}");
    // Half a step each: 2⁻¹², 1/16, 1/(255 · 0.15), and nothing for 8 bits that both have.
    assert!(mean <= 1.01 * 0.5 / 4096.0 && scale <= 1.01 * 0.5 / 16.0 && color <= 1.01 * 0.5 / (255.0 * 0.15));
    assert!(opacity <= 1e-6);
}

/// The discs lie on a mesh whose largest extent is known; training leaves few splats far from the scene.
#[test]
#[ignore = "needs OCTOBAYES_DATA/splats and splats-trained"]
fn means_lie_where_the_scene_is_in_data_of_every_source() {
    for (name, low, high) in [
        ("splats/biker.spz", Vec3::new(-10.0, -3.2, -0.55), Vec3::new(10.0, 0.01, 0.63)),
        ("splats-trained/lego_15k_sh3.ply", Vec3::splat(-1.5), Vec3::splat(1.5)),
        ("splats-trained/lego_10views_5k_sh2.ply", Vec3::splat(-1.5), Vec3::splat(1.5)),
    ] {
        let quantiles = read(&data(name)).summary().means;
        for axis in 0..3 {
            let [_, first, median, last, _] = quantiles[axis];
            assert!(low[axis] <= first && first < median && median < last && last <= high[axis], "{name}: {axis}");
        }
    }
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/splats-trained"]
fn cameras_equal_their_twins_in_data_of_trained_splats() {
    for name in ["lego_15k_sh3", "lego_10views_5k_sh2", "lego_half12_6k_sh2", "spot_half12_3k_sh1"] {
        let [inria, nerf] = ["cameras", "transforms"]
            .map(|kind| Views::read(&data("splats-trained").join(format!("{name}_{kind}.json")), None).unwrap());
        assert_eq!(inria.frames.len(), nerf.frames.len(), "{name}");
        for (a, b) in inria.frames.iter().zip(&nerf.frames) {
            assert_eq!(a.name, b.name);
            for (x, y) in [(0.5, 0.5), (150.5, 20.5), (100.0, 100.0)] {
                let [a, b] = [a, b].map(|frame| frame.camera.ray(x, y));
                let apart = (a.origin - b.origin).length().max((a.direction - b.direction).length());
                assert!(apart < 1e-6, "{name}: {apart}");
            }
        }
    }
}

/// What a writer keeps of a file with 62 properties is all of it, but for the lengths of rotations.
#[test]
#[ignore = "needs OCTOBAYES_DATA/splats"]
fn data_of_the_original_code_are_written_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("again.ply");
    let whole = read(&data("splats/sh3_iteration_7000.ply"));
    whole.write_ply(&path, &[], &[]).unwrap();
    assert_eq!(read(&path).summary(), whole.summary());
    let header = |path: &Path| -> Vec<String> {
        let bytes = std::fs::read(path).unwrap();
        let text = String::from_utf8_lossy(&bytes[..4000]).into_owned();
        text.lines().filter(|line| line.starts_with("property")).map(str::to_string).collect()
    };
    assert_eq!(header(&path), header(&data("splats/sh3_iteration_7000.ply")));
    assert_eq!(read(&path).extra_names(), ["nx", "ny", "nz"]);
}
