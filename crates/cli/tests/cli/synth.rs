//! Synthetic data sets against closed forms: what is written must be what geometry says.

use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::program::Desk;
use glam::DVec3;
use octobayes::geometry::Ray;
use octobayes::monitor::Silent;
use octobayes_data::Hemisphere;
use octobayes_data::{DepthEncoding, DepthKind, DepthMap, PosedImage, Views, read_object};
use octobayes_synth::{
    DEPTH_PNG_SCALE, DatasetSettings, GROUND_RADIUS, HALF_HEIGHT, Mesh, MeshScene, RADIUS, Up, write_dataset,
};

/// A sphere with 2·`rings` meridians. Poles and equator are vertices, so it is placed around 0 with radius exactly
/// 0.75.
fn sphere(rings: usize) -> String {
    let columns = 2 * rings;
    let mut text = String::new();
    for ring in 0..=rings {
        for column in 0..columns {
            let (polar, azimuth) = (PI * ring as f64 / rings as f64, TAU * column as f64 / columns as f64);
            let [x, y, z] = [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()];
            text += &format!("v {x:.9} {y:.9} {z:.9}\n");
        }
    }
    for ring in 0..rings {
        for column in 0..columns {
            let at = |r: usize, c: usize| r * columns + c % columns + 1;
            let [a, b] = [at(ring, column), at(ring, column + 1)];
            let [c, d] = [at(ring + 1, column), at(ring + 1, column + 1)];
            text += &format!("f {a} {c} {d}\nf {a} {d} {b}\n");
        }
    }
    text
}

fn exact_depth(path: &Path) -> Vec<f32> {
    let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
    let [channel] = &image.layer_data.channel_data.list[..] else { panic!("one channel expected") };
    assert!(channel.name.eq("depth.Z"));
    channel.sample_data.values_as_f32().collect()
}

/// Distances at which a ray meets the sphere of `radius` around 0.
fn enter(ray: &Ray, radius: f64) -> Option<f64> {
    let b = ray.origin.dot(ray.direction);
    let root = b * b - ray.origin.length_squared() + radius * radius;
    (root >= 0.0).then(|| -b - root.sqrt())
}

/// Distance to the ground disc.
fn ground(ray: &Ray) -> Option<f64> {
    let t = (-HALF_HEIGHT - ray.origin.z) / ray.direction.z;
    (t > 0.0 && ray.at(t).truncate().length() <= GROUND_RADIUS).then_some(t)
}

/// Half a unit in the last place of an f32, and the f64 rounding of numbers below 8.
fn rounding(t: f64) -> f64 {
    0.5 * f64::from((t as f32).next_up() - t as f32) + 1e-14
}

#[test]
fn depth_is_that_of_the_sphere_and_the_ground() {
    const RINGS: usize = 60;
    let folder = tempfile::tempdir().unwrap();
    let obj = folder.path().join("sphere.obj");
    std::fs::write(&obj, sphere(RINGS)).unwrap();
    let out = folder.path().join("data");
    let settings = DatasetSettings::default()
        .up(Up::Z)
        .views(3)
        .hemisphere(Some(Hemisphere::Left))
        .test_views(2)
        .resolution([72, 60])
        .samples_per_side(2)
        .seed(5);
    write_dataset(&obj, &out, &settings, &Silent).unwrap();

    // Triangles are chords: their points lie between sqrt(r² − ρ²) and r from the centre, with circumradius ρ.
    // Both halves of an isosceles trapezoid share its circle: `ρ² = (l² + p·q) / 4 sin²θ` with legs l, bases p, q
    // and base angle θ. All sides are below r·π/RINGS. They are largest at the equator, where θ is a right angle;
    // towards the poles p·q shrinks faster than sin²θ. So `2ρ² ≤ (r·π/RINGS)²`. Vertices are off the sphere by the
    // rounding to 9 digits and to f32: 1e-7.
    let chord = RADIUS * PI / RINGS as f64;
    let inner = (RADIUS * RADIUS - 0.5 * chord * chord).sqrt() - 1e-7;
    let outer = RADIUS + 1e-7;
    let (mut on_sphere, mut on_ground, mut empty, mut deepest) = (0, 0, 0, 0.0_f64);
    for split in ["train", "test"] {
        let views = Views::read(&out.join(format!("transforms_{split}.json")), None).unwrap();
        assert_eq!(views.frames.len(), if split == "train" { 3 } else { 2 });
        for (i, frame) in views.frames.iter().enumerate() {
            let camera = &frame.camera;
            assert_eq!(camera.resolution, [72, 60]);
            assert!(split == "test" || camera.position.x < 0.0, "training cameras stand on the left");
            let image = PosedImage::read(&frame.image, frame.camera.resolution).unwrap();
            let object = read_object(frame).unwrap().unwrap();
            let depth = exact_depth(&out.join(format!("depth/{split}_{i:04}.exr")));
            let encoding = DepthEncoding { offset: 0.0, scale: DEPTH_PNG_SCALE, kind: DepthKind::Euclidean };
            let png = out.join(format!("depth/{split}_{i:04}.png"));
            let steps = DepthMap::read(&png, encoding, camera, 0.5).unwrap();
            for (k, &found) in depth.iter().enumerate() {
                let center = [f64::from(k as u32 % 72) + 0.5, f64::from(k as u32 / 72) + 0.5];
                let ray = camera.ray(center[0], center[1]);
                let t = f64::from(found);
                let is_object = object.keeps(k as u32 % 72, k as u32 / 72);
                match steps.distance[k] {
                    // Half a step of 1e-4, and the rounding to f32.
                    Ok(step) => assert!((step - t).abs() <= 0.5e-4 + 1e-6 && found > 0.0),
                    Err(_) => assert_eq!(found, 0.0),
                }
                if found > 0.0 {
                    // The hit point projects to the centre of its pixel: f32 rounding is along the ray.
                    let pixel = camera.project(ray.at(t)).unwrap().0;
                    assert!((0..2).all(|axis| (pixel[axis] - center[axis]).abs() < 1e-10), "{pixel:?} for {center:?}");
                }
                if let Some(deep) = enter(&ray, inner) {
                    let shallow = enter(&ray, outer).unwrap();
                    let within = shallow - rounding(t)..=deep + rounding(t);
                    assert!(within.contains(&t), "{t} is not in {within:?}");
                    assert!(is_object, "{center:?}");
                    deepest = deepest.max(RADIUS - ray.at(t).length());
                    on_sphere += 1;
                } else if enter(&ray, outer).is_none() {
                    let expected = ground(&ray).unwrap_or(0.0);
                    assert!((t - expected).abs() <= rounding(t), "ground: {t} for {expected}");
                    assert!(!is_object, "{center:?}");
                    if expected > 0.0 { on_ground += 1 } else { empty += 1 }
                }
                if image.is_opaque(k) {
                    assert!(image.over(k, DVec3::ZERO).max_element() < 1.0, "nothing is overexposed");
                }
            }
        }
    }
    assert!(on_sphere > 3000 && on_ground > 1000 && empty > 1000, "{on_sphere}, {on_ground}, {empty}");
    // The bound is not idle: the deepest point found comes close to it, so chords are seen as chords.
    assert!(deepest > 0.5 * (RADIUS - inner), "{deepest} of {}", RADIUS - inner);
}

#[test]
fn depth_of_a_plane_is_exact_to_f32() {
    // A wall x + 2y = 0 of two triangles, placed around the origin.
    let corners = [[2.0, -1.0, 0.0], [-2.0, 1.0, 0.0], [-2.0, 1.0, 3.0], [2.0, -1.0, 3.0]].map(DVec3::from);
    let (wall, _) = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap().placed(Up::Z);
    let scene = MeshScene::new(wall);
    let normal = DVec3::new(1.0, 2.0, 0.0);
    let eye = DVec3::new(1.3, 2.9, 0.4);
    let mut hits = 0;
    for i in 0..10_000 {
        let target = DVec3::new(0.0, 0.012 * f64::from(i % 100) - 0.6, 0.014 * f64::from(i / 100) - 0.7);
        let ray = Ray::new(eye, target - eye);
        let t = -eye.dot(normal) / ray.direction.dot(normal);
        let at = ray.at(t);
        // Inside the wall's rectangle, away from its rim. The radius decides its scale, 0.335, so its top is at
        // 0.256.
        if (-0.74..0.25).contains(&at.z) && at.truncate().length() < 0.65 {
            let found = f64::from(scene.nearest(&ray).expect("the wall has no gaps").t as f32);
            assert!((found - t).abs() <= rounding(t), "{found} for {t}");
            hits += 1;
        }
    }
    assert!(hits > 3000, "{hits}");
}

#[test]
fn one_thread_and_two_write_the_same_bytes() {
    let desk = Desk::empty();
    desk.write("ball.obj", sphere(8));
    let options = "--count 2 --test-count 1 --resolution 40x30 --samples-per-pixel 4 --up z";
    for threads in [1, 2] {
        desk.good(&format!("synth ball.obj -o data{threads} {options} --threads {threads}"));
    }
    let pictures = ["train_0000", "train_0001", "test_0000"].into_iter();
    let pictures =
        pictures.flat_map(|i| [format!("images/{i}.png"), format!("depth/{i}.exr"), format!("depth/{i}.png")]);
    let files = ["README.md", "dataset.json", "transforms_train.json", "transforms_test.json"].map(String::from);
    for name in pictures.chain(files) {
        let [one, two] = [1, 2].map(|n| desk.bytes(&format!("data{n}/{name}")));
        assert!(!one.is_empty() && one == two, "{name} differs");
    }
}

#[test]
fn refusals_are_one_line_and_leave_nothing() {
    let desk = Desk::empty();
    desk.write("quad.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
    desk.write("far.obj", "v 4999999 0 0\nv 5000000 0 0\nv 5000000 1 0\nf 1 2 3\n");
    desk.write("good.obj", sphere(3));
    std::fs::create_dir(desk.join("full")).unwrap();
    desk.write("full/file", "kept");
    let rows: [(&str, &[&str]); 6] = [
        ("quad.obj -o out", &["quad.obj: face 1", "3 corners", "found 4"]),
        ("far.obj -o out", &["far.obj: mesh", "near its origin", "5000000"]),
        ("good.obj -o full", &["full: output folder"]),
        ("good.obj -o quad.obj", &["quad.obj"]),
        ("good.obj -o no/such", &["no/such"]),
        ("good.obj -o out --resolution 65536", &["resolution"]),
    ];
    rows.iter().for_each(|(args, words)| drop(desk.refused(&format!("synth {args}"), words)));
}

#[test]
#[cfg(unix)]
fn a_program_that_is_told_to_end_leaves_nothing_and_one_that_is_killed_leaves_it_to_the_next() {
    let desk = Desk::empty();
    desk.write("ball.obj", sphere(8));
    let count = || desk.files().len();
    let start = |views: u32| {
        let args = format!("synth ball.obj -o data --count {views} --test-count 1 --resolution 60");
        desk.command(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    for signal in ["-INT", "-TERM"] {
        let mut child = start(100_000);
        while count() == 1 {
            assert!(child.try_wait().unwrap().is_none(), "it ended before it was told to");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        assert_eq!((child.wait().unwrap().code(), count()), (Some(130), 1), "{signal}");
    }
    let mut child = start(100_000);
    while count() == 1 {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(count(), 2, "the mesh and what was left");
    assert!(start(1).wait().unwrap().success());
    assert_eq!(count(), 2, "the mesh and the data");
    assert!(desk.join("data/transforms_train.json").exists());
}

#[test]
#[ignore = "needs OCTOBAYES_DATA/meshes"]
fn meshes_of_the_data_are_traced_as_a_scan_of_all_faces_says() {
    let data = std::env::var("OCTOBAYES_DATA").expect("OCTOBAYES_DATA names the data folder");
    for name in ["spot", "stanford-bunny", "armadillo", "nefertiti"] {
        let mesh = Mesh::read(&Path::new(&data).join(format!("meshes/{name}.obj"))).unwrap();
        let scene = MeshScene::new(mesh.placed(Up::Y).0);
        let mut hits = 0;
        for i in 0..200_u32 {
            // Every other ray aims at a vertex, the others anywhere.
            let vertices = scene.mesh().vertices();
            let eye =
                3.4 * DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.3 + 0.01 * f64::from(i % 40)).normalize();
            let vertex = vertices[i as usize * 7919 % vertices.len()];
            let target = if i % 2 == 0 { vertex } else { 0.9 * DVec3::new(vertex.y, vertex.z, vertex.x) };
            let ray = Ray::new(eye, target - eye);
            let expected = scene.nearest_of_all(&ray);
            assert_eq!(scene.nearest(&ray), expected, "{name}, ray {i}");
            hits += u32::from(expected.is_some());
        }
        assert!(hits >= 100, "{name}: {hits} hits");
    }
}
