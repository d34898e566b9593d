//! A kitchen seen by an RGB-D camera (7-Scenes), as images with depth.

use std::path::Path;

use glam::{DMat3, DVec3};
use image::imageops::FilterType;
use image::{ImageBuffer, ImageReader, Luma};
use octobayes::geometry::{Camera, Distortion};
use octobayes::{Error, Result};
use octobayes_data::DepthKind;
use octobayes_evaluation::DepthFiles;

use super::program::Program;

/// Converts the kitchen into a data set in `folder`, unless it is there. Returns where the held-out frames' depth is.
pub fn kitchen(folder: &Path) -> Result<DepthFiles> {
    if !folder.exists() {
        convert(&Program::data()?.join("rgbd-7scenes-kitchen"), folder)?;
    }
    let (folder, pattern) = (Some(folder.join("depth")), "{}.png".into());
    Ok(DepthFiles { folder, pattern, scale: Some([0.0, MILLIMETRES]), kind: DepthKind::Z })
}

/// Focal lengths in pixels of the sensor's images, 640 × 480, with the principal point in the middle. Colour and depth
/// have a camera each; the file `camera-intrinsics.txt` beside the frames is that of depth.
const COLOR_FOCAL: f64 = 525.0;
const DEPTH_FOCAL: f64 = 585.0;
/// From the depth camera to the colour camera, metres, OpenCV axes: rotation by rows, and translation.
const REGISTRATION: ([[f64; 3]; 3], [f64; 3]) = (
    [
        [0.99996518, 0.00267651, -0.00790410],
        [-0.00274093, 0.99996303, -0.00815045],
        [0.00788199, 0.00817183, 0.99993555],
    ],
    [-0.02555894, 0.00010110, 0.00203183],
);
/// Depth of white, metres: the sensor's unit is a millimetre.
const MILLIMETRES: f64 = 65.535;
/// One frame in this many is held out.
const HELD_OUT: usize = 4;
/// Readings of one pixel that differ by more than this, millimetres, straddle an edge.
const EDGE: f64 = 50.0;
/// Readings that a pixel of half the size needs: some five fall into each.
const READINGS: usize = 3;

/// Depth along the colour camera's axis in an image of 320 × 240, millimetres, from what the depth camera saw; 0 where
/// its readings are few, or straddle an edge.
fn registered(depth: &ImageBuffer<Luma<u16>, Vec<u16>>) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    let (rows, shift) = (REGISTRATION.0.map(DVec3::from), DVec3::from(REGISTRATION.1));
    let mut readings = vec![Vec::new(); 320 * 240];
    for (x, y, pixel) in depth.enumerate_pixels().filter(|(_, _, p)| !matches!(p.0[0], 0 | u16::MAX)) {
        let z = f64::from(pixel.0[0]) / 1000.0;
        let seen = DVec3::new(f64::from(x) + 0.5 - 320.0, f64::from(y) + 0.5 - 240.0, DEPTH_FOCAL) * (z / DEPTH_FOCAL);
        let seen = DVec3::from(rows.map(|row| row.dot(seen))) + shift;
        let [u, v] = [seen.x, seen.y].map(|a| 0.5 * COLOR_FOCAL * a / seen.z);
        let (u, v) = ((u + 160.0).floor(), (v + 120.0).floor());
        if (0.0..320.0).contains(&u) && (0.0..240.0).contains(&v) {
            readings[v as usize * 320 + u as usize].push(1000.0 * seen.z);
        }
    }
    ImageBuffer::from_fn(320, 240, |x, y| {
        let here = &readings[(y * 320 + x) as usize];
        let [least, most] = [f64::min, f64::max].map(|either| here.iter().copied().reduce(either).unwrap_or(0.0));
        let is_known = here.len() >= READINGS && most - least <= EDGE;
        Luma([if is_known { (here.iter().sum::<f64>() / here.len() as f64).round() as u16 } else { 0 }])
    })
}

/// Converts the RGB-D frames: half the size, OpenGL axes, depth as the colour camera would see it; a box around
/// everything that was seen and the cameras.
fn convert(source: &Path, folder: &Path) -> Result<()> {
    let staged = folder.with_extension("part");
    for part in ["images", "depth"] {
        let path = staged.join(part);
        std::fs::create_dir_all(&path).map_err(Error::io(&path, "cannot create the folder"))?;
    }
    let picture = |path: &Path| -> Result<image::DynamicImage> {
        let reader = ImageReader::open(path).map_err(Error::io(path, "cannot open"))?;
        let image = reader.decode().map_err(|e| Error::malformed(path, "image", "a picture", e.to_string()))?;
        Ok(image)
    };
    let unwritable = |path: &Path| {
        let path = path.to_path_buf();
        move |e: image::ImageError| Error::malformed(&path, "image", "a picture that can be written", e.to_string())
    };
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut frames = Vec::new();
    for i in 0..40 {
        let name = format!("frame-{:06}", 25 * i);
        let pose_file = source.join(format!("{name}.pose.txt"));
        let pose = std::fs::read_to_string(&pose_file).map_err(Error::io(&pose_file, "cannot read"))?;
        let m: Vec<f64> = pose.split_whitespace().filter_map(|v| v.parse().ok()).collect();
        assert_eq!(m.len(), 16, "{} holds a 4 x 4 matrix", pose_file.display());
        let column = |k: usize| DVec3::new(m[k], m[4 + k], m[8 + k]);
        // OpenCV looks along +z with y down.
        let camera = Camera {
            position: column(3),
            axes: DMat3::from_cols(column(0), -column(1), -column(2)),
            focal: [0.5 * COLOR_FOCAL; 2],
            center: [160.0, 120.0],
            resolution: [320, 240],
            distortion: Distortion::default(),
        };
        let color = picture(&source.join(format!("{name}.color.jpg")))?;
        let path = staged.join(format!("images/{name}.png"));
        color.resize_exact(320, 240, FilterType::Triangle).to_rgb8().save(&path).map_err(unwritable(&path))?;

        let depth = picture(&source.join(format!("{name}.depth.png")))?.to_luma16();
        let half = registered(&depth);
        for (x, y, pixel) in half.enumerate_pixels().filter(|(_, _, p)| p.0[0] > 0) {
            let ray = camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let z = f64::from(pixel.0[0]) / 1000.0;
            let point = ray.at(z / ray.direction.dot(-camera.axes.z_axis));
            (low, high) = (low.min(point), high.max(point));
        }
        (low, high) = (low.min(camera.position), high.max(camera.position));
        let path = staged.join(format!("depth/{name}.png"));
        half.save(&path).map_err(unwritable(&path))?;
        frames.push((format!("images/{name}.png"), camera));
    }
    let (low, high) = (low - 0.1, high + 0.1);
    let is_test = |i: &usize| i % HELD_OUT == HELD_OUT / 2;
    for (split, tests) in [("train", false), ("test", true)] {
        let frames: Vec<serde_json::Value> = (0..frames.len())
            .filter(|i| is_test(i) == tests)
            .map(|i| {
                let (name, camera) = &frames[i];
                let row = |k: usize| {
                    let [x, y, z] = [camera.axes.x_axis, camera.axes.y_axis, camera.axes.z_axis];
                    [x[k], y[k], z[k], camera.position[k]]
                };
                let pose = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
                serde_json::json!({ "file_path": name, "transform_matrix": pose })
            })
            .collect();
        let file = serde_json::json!({
            "fl_x": 0.5 * COLOR_FOCAL, "fl_y": 0.5 * COLOR_FOCAL, "cx": 160.0, "cy": 120.0, "w": 320, "h": 240,
            "aabb": [low.to_array(), high.to_array()], "frames": frames,
        });
        let path = staged.join(format!("transforms_{split}.json"));
        std::fs::write(&path, file.to_string()).map_err(Error::io(&path, "cannot write"))?;
    }
    // Complete or not there.
    std::fs::rename(&staged, folder).map_err(Error::io(folder, "cannot rename the finished folder"))
}
