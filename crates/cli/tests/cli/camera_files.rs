//! What camera files say of frames and pixels decides what counts as seen.

use crate::npz::NpzWriter;
use crate::program::Desk;
use glam::{DVec3, Vec3};
use octobayes::geometry::Camera;
use serde_json::{Value, json};

/// Centres of four balls, each seen by one camera alone.
const BALLS: [[f64; 2]; 4] = [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]];
const SIDE: u32 = 24;
const RUN: &str = "uncertainty model.npz --level 5 --rays 4000 --occupancy 32 -o f.oct --cameras";

struct Scene(Desk);

impl std::ops::Deref for Scene {
    type Target = Desk;

    fn deref(&self) -> &Desk {
        &self.0
    }
}

impl Scene {
    fn new() -> Self {
        let desk = Self(Desk::empty());
        const N: u64 = 40;
        let at = |i: u64| -1.0 + 2.0 * i as f32 / (N - 1) as f32;
        let place = |i: u64| Vec3::new(at(i / (N * N)), at(i / N % N), at(i % N));
        let ball = |x: Vec3| BALLS.iter().any(|c| (x - Vec3::new(c[0] as f32, c[1] as f32, 0.0)).length() < 0.2);
        let mut npz = NpzWriter::create(&desk.join("model.npz"));
        npz.array("box", &[2, 3], [-1.0_f32, -1.0, -1.0, 1.0, 1.0, 1.0]);
        npz.array("density", &[N, N, N], (0..N * N * N).map(|i| if ball(place(i)) { 60.0_f32 } else { 0.0 }));
        let stripes = |i: u64| place(i).to_array().map(|x| 0.5 + 0.4 * (9.0 * x).sin());
        npz.array("color", &[N, N, N, 3], (0..N * N * N).flat_map(stripes));
        npz.finish();
        std::fs::create_dir(desk.join("images")).unwrap();
        (0..4).for_each(|i| desk.picture(&format!("images/{i}.png"), 128));
        desk
    }

    /// A picture of one shade of grey.
    fn picture(&self, name: &str, shade: u8) {
        image::GrayImage::from_pixel(SIDE, SIDE, image::Luma([shade])).save(self.join(name)).unwrap();
    }

    /// Writes a camera file of the four cameras, after `change`.
    fn cameras(&self, change: impl Fn(&mut Value)) {
        let frames = BALLS.iter().enumerate().map(|(i, [x, y])| {
            let camera = Camera::look_at(DVec3::new(*x, *y, 3.0), DVec3::new(*x, *y, 0.0), DVec3::Y, 0.25, [SIDE; 2]);
            let row =
                |k: usize| [camera.axes.x_axis[k], camera.axes.y_axis[k], camera.axes.z_axis[k], camera.position[k]];
            let pose = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
            json!({"file_path": format!("images/{i}.png"), "transform_matrix": pose})
        });
        let frames: Vec<Value> = frames.collect();
        let mut file = json!({"camera_angle_x": 0.25, "w": SIDE, "h": SIDE, "frames": frames});
        change(&mut file);
        // Some editors begin files with a byte order mark.
        self.write("t.json", format!("\u{feff}{file}"));
    }

    /// Which balls the cameras in use have seen, as `#` and `.`, and what was said.
    fn seen(&self, args: &str) -> (String, String) {
        let said = self.said(&format!("{RUN} t.json {args}"));
        let field = self.field("f.oct");
        let is_seen = |[x, y]: &[f64; 2]| {
            let front = Vec3::new(*x as f32, *y as f32, 0.19);
            // The prior is 4.6; what a ray saw is two decades below it.
            let below = field.prior().log10() - field.query(front).uncertainty.log10();
            assert!(!(0.2..1.5).contains(&below), "{below} decades below the prior at {front}");
            if below > 1.0 { '#' } else { '.' }
        };
        (BALLS.iter().map(is_seen).collect(), said)
    }
}

#[test]
fn lists_of_training_frames_are_honoured() {
    let desk = Scene::new();
    desk.cameras(|file| file["train_filenames"] = json!(["images/3.png", "./images/1.png"]));
    let (balls, said) = desk.seen("");
    assert_eq!(balls, ".#.#");
    assert!(said.contains("2 cameras of 4 frames of t.json: 2 are in neither part"), "{said}");
    desk.cameras(|file| file["test_filenames"] = json!(["images/0.png"]));
    let (balls, said) = desk.seen("");
    assert_eq!(balls, ".###");
    assert!(said.contains("1 is held out, by the file"), "{said}");
    assert_eq!(desk.seen("--views all").0, "####");
    desk.cameras(|file| file["n_frames"] = json!(1));
    assert_eq!(desk.seen("").0, "#...");
    desk.cameras(|file| {
        let last = file["frames"].as_array_mut().unwrap().pop().unwrap();
        file["test_frames"] = json!([last]);
    });
    assert_eq!(desk.seen("").0, "###.");
    assert_eq!(desk.seen("--views 3,").0, "...#");
    desk.cameras(|file| file["train_filenames"] = json!(["images/7.png"]));
    desk.refused(&format!("{RUN} t.json"), &["found `images/7.png`"]);
}

#[test]
fn masked_pixels_were_not_trained_on() {
    let desk = Scene::new();
    desk.picture("black.png", 0);
    desk.picture("images/dynamic_mask_0.png", 255);
    desk.cameras(|file| file["frames"][2]["mask_path"] = json!("black.png"));
    let (balls, said) = desk.seen("--views all");
    assert_eq!(balls, ".#.#");
    assert!(said.contains("masks of 2 of 4 frames leave out 50.0 % of the pixels"), "{said}");
    // Not the cameras of a run without masks.
    desk.good(&format!("{RUN} t.json --views all --seed 1 --keep-sums").replace("f.oct", "masked.oct"));
    desk.cameras(|_| {});
    std::fs::remove_file(desk.join("images/dynamic_mask_0.png")).unwrap();
    desk.good(&format!("{RUN} t.json --views all --keep-sums").replace("f.oct", "whole.oct"));
    desk.refused("merge whole.oct masked.oct -o x.oct", &["model and cameras of masked.oct"]);
    desk.cameras(|file| {
        file["frames"].as_array_mut().unwrap().iter_mut().for_each(|f| f["mask_path"] = json!("black.png"));
    });
    desk.refused(&format!("{RUN} t.json --views all"), &["masks that keep none"]);
    image::GrayImage::new(SIDE, SIDE - 1).save(desk.join("black.png")).unwrap();
    desk.refused(&format!("{RUN} t.json --views all"), &["black.png: mask", "24 x 24", "24 x 23"]);
}

#[test]
fn a_model_that_was_trained_with_masks_needs_them_again() {
    let desk = Scene::new();
    desk.picture("black.png", 0);
    desk.cameras(|file| file["frames"][2]["mask_path"] = json!("black.png"));
    let train = "train t.json -o m.safetensors --steps 20 --samples-per-step 4096 --log2-hashmap-size 12";
    desk.good(&format!("{train} --views all"));
    let run = "uncertainty m.safetensors --level 4 --rays 2000 --occupancy 16 -o m.oct --force";
    desk.refused(run, &["--cameras", "1 cameras with masks"]);
}

#[test]
fn keys_that_nobody_reads_are_named_once() {
    let desk = Scene::new();
    desk.cameras(|file| {
        file["fancy_lens"] = json!(3);
        file["aabb_scale"] = json!(2);
        file["scale"] = json!(0.1);
        (0..4).for_each(|i| file["frames"][i]["tilt"] = json!(0.5));
    });
    let (_, said) = desk.seen("");
    assert_eq!((said.matches("`fancy_lens`").count(), said.matches("`tilt`").count()), (1, 1), "{said}");
    assert!(!said.contains("aabb_scale") && said.contains("`scale` and `offset`"), "{said}");
    desk.cameras(|file| {
        file["scale"] = json!(0.33);
        file["offset"] = json!([0.5, 0.5, 0.5]);
    });
    let (_, said) = desk.seen("");
    assert!(!said.contains("`scale`"), "{said}");
}
