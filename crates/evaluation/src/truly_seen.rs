//! What training cameras truly saw, by their depth maps.

use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::{Monitor, check};
use octobayes_data::{DepthReadings, Frame};
use octobayes_depth::TrainingViews;
use rayon::prelude::*;

use super::DepthMeaning;

/// The depth that the cameras of frames with depth maps truly saw, and what the maps hold. Where a map holds no
/// measurement, its camera saw to infinity. A stage of its own for the monitor.
///
/// # Errors
/// If a map is missing or damaged, or its size differs from its camera's; [`octobayes::Error::Interrupted`].
pub fn from_depth_maps(
    frames: &[Frame],
    depth: &DepthMeaning,
    pixel_offset: f64,
    monitor: &dyn Monitor,
) -> Result<(TrainingViews, DepthReadings)> {
    let view = |frame: &Frame| {
        check(monitor)?;
        let distance = depth.read(frame, pixel_offset)?.distance;
        let mut readings = DepthReadings::default();
        distance.iter().for_each(|distance| readings.count(*distance));
        let depths = distance.into_iter().map(|d| d.map_or(f32::INFINITY, |d| d as f32)).collect();
        monitor.advance(1);
        Ok(((frame.camera, depths), readings))
    };
    monitor.begin("training depth maps", frames.len() as u64);
    let found: Vec<((Camera, Vec<f32>), DepthReadings)> = frames.par_iter().map(view).collect::<Result<_>>()?;
    monitor.end();
    let mut readings = DepthReadings::default();
    found.iter().for_each(|(_, of_view)| readings += *of_view);
    Ok((TrainingViews::of_depths(found.into_iter().map(|(view, _)| view)), readings))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::{DepthFiles, FramesWithDepth};
    use octobayes::monitor::Silent;
    use octobayes_data::DepthKind;

    #[test]
    fn by_true_depth_a_ball_is_seen_where_it_faces_a_camera() {
        const RADIUS: f64 = 1.0;
        let from = |eye: DVec3| Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.9, [400; 2]);
        let cameras = [DVec3::new(3.0, 0.0, 0.5), DVec3::new(-1.0, 3.0, 0.2)].map(from);
        let folder = tempfile::tempdir().unwrap();
        let name = |i: usize| format!("images/r_{i}.png");
        let mut frames: Vec<Frame> = (0..).zip(&cameras).map(|(i, camera)| Frame::new(*camera, name(i), "")).collect();
        let files = DepthFiles {
            folder: Some(folder.path().into()),
            pattern: "{}.exr".into(),
            scale: None,
            kind: DepthKind::Euclidean,
        };
        // What programs write where there is no surface, and a far plane.
        let read = |nothing: f32| {
            let mut missed = 0;
            for (i, camera) in cameras.iter().enumerate() {
                let mut depth = |pixel: usize| {
                    let ray = camera.ray((pixel % 400) as f64 + 0.5, (pixel / 400) as f64 + 0.5);
                    let (b, c) = (ray.origin.dot(ray.direction), ray.origin.length_squared() - RADIUS * RADIUS);
                    let root = b * b - c;
                    missed += u64::from(root <= 0.0);
                    if root > 0.0 { (-b - root.sqrt()) as f32 } else { nothing }
                };
                let depths = (0..400 * 400).map(&mut depth).collect();
                let path = folder.path().join(format!("r_{i}.exr"));
                octobayes_data::write_exr(&path, [400; 2], vec![("depth.Z", depths)]).unwrap();
            }
            let FramesWithDepth { frames, encoding, .. } = files.find(folder.path(), &frames, &frames).unwrap();
            let depth = DepthMeaning { encoding, bounds: octobayes::geometry::Aabb::centered_cube(RADIUS), jump: 0.0 };
            let (views, readings) = from_depth_maps(&frames, &depth, 0.5, &Silent).unwrap();
            assert_eq!((readings.measured, readings.total()), (320_000 - missed, 320_000), "{nothing}");
            views
        };
        let views = read(0.0);
        assert_eq!((views.len(), views.is_empty()), (2, false));
        for nothing in [1e10, 65504.0, f32::MAX, f32::INFINITY, f32::NAN, -1.0, 1000.0] {
            assert!(read(nothing) == views, "{nothing}");
        }
        let (mut seen, mut hidden) = (0, 0);
        for i in 0..4000 {
            // A spiral over the ball.
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
            let (sin, cos) = (2.399_963_229_728_653 * f64::from(i)).sin_cos();
            let normal = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            let facing = cameras.map(|camera| normal.dot((camera.position - RADIUS * normal).normalize()));
            // A point is at most √½ of a pixel's width from the middle of its pixel, and the surface there two widths
            // nearer only if its slope exceeds 2.8: where the cosine is below 0.34.
            if facing.iter().any(|cos| cos.abs() < 0.34) {
                continue;
            }
            let expected = facing.iter().filter(|cos| **cos > 0.0).count();
            assert_eq!(views.sighting(RADIUS * normal).views, expected, "at {normal}");
            (seen, hidden) = (seen + usize::from(expected > 0), hidden + usize::from(expected == 0));
        }
        assert!(seen > 1000 && hidden > 500, "{seen} seen, {hidden} not");
        frames[1].name = "images/r_9.png".into();
        let missing = files.find(folder.path(), &frames, &frames).unwrap_err().to_string();
        assert!(missing.ends_with("none of images/r_9.exr, r_9.exr"), "{missing}");
    }
}
