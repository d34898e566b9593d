//! Cameras on a circle.

use glam::{DMat3, DQuat, DVec3};

use crate::geometry::{Camera, Domain};

/// `count` cameras like `start`, turned in equal steps about the upright axis through what it looks at.
///
/// Upright is what is level in `others`. What it looks at is the point of its optical axis next to the
/// upright axis through the middle of `domain`.
pub fn orbit(start: &Camera, others: &[Camera], domain: &Domain, count: u32) -> Vec<Camera> {
    let up = upright(others).unwrap_or(start.axes.y_axis);
    let middle = match domain {
        Domain::Box(bounds) => 0.5 * (bounds.min() + bounds.max()),
        Domain::Contracted { center, .. } => DVec3::from(*center),
    };
    let ahead = -start.axes.z_axis;
    // Seen from above, so that the turn is about the middle whatever height the camera looks at.
    let level = ahead - ahead.dot(up) * up;
    let (towards, length) = if level.length() > 0.05 { (level, level.length_squared()) } else { (ahead, 1.0) };
    let distance = (towards.dot(middle - start.position) / length).max(0.0);
    let target = start.position + distance * ahead;
    let turned = |k: u32| {
        let turn = DQuat::from_axis_angle(up, std::f64::consts::TAU * f64::from(k) / f64::from(count));
        let position = target + turn * (start.position - target);
        Camera { position, axes: DMat3::from_quat(turn) * start.axes, ..*start }
    };
    (0..count).map(turned).collect()
}

/// What is up for cameras that are held level, however far they look down: at right angles to what is right in their
/// images. `None` for cameras all around, upside down too.
fn upright(cameras: &[Camera]) -> Option<DVec3> {
    let mean = cameras.iter().map(|camera| camera.axes.y_axis).sum::<DVec3>() / cameras.len() as f64;
    let agreeing = |normal: DVec3| if normal.dot(mean) < 0.0 { -normal } else { normal };
    let right = |k: usize| cameras[k].axes.x_axis;
    let pairs = (0..cameras.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let level: DVec3 = pairs.map(|(i, j)| agreeing(right(i).cross(right(j)))).sum();
    let count = (cameras.len() * cameras.len().saturating_sub(1) / 2) as f64;
    // Cameras side by side say too little of it.
    let normal = if level.length() > 0.05 * count { level } else { mean };
    (mean.length() > 0.05).then(|| normal.normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn cameras_on_one_side_that_look_down_are_level() {
        let look = |azimuth: f64, height: f64| {
            Camera::look_at(
                DVec3::new(2.8 * azimuth.cos(), 2.8 * azimuth.sin(), height),
                DVec3::ZERO,
                DVec3::Z,
                0.8,
                [4; 2],
            )
        };
        let arc: Vec<Camera> = (0..9).map(|k| look(0.25 * f64::from(k) - 1.0, 0.9 + 0.8 * f64::from(k % 2))).collect();
        assert!((upright(&arc).unwrap() - DVec3::Z).length() < 1e-9);
        // One alone, and two that look the same way, are upright by their images.
        assert!((upright(&arc[..1]).unwrap() - arc[0].axes.y_axis).length() < 1e-9);
        assert!((upright(&[arc[0], arc[0]]).unwrap() - arc[0].axes.y_axis).length() < 1e-9);
        let turned = Camera { axes: arc[0].axes * DMat3::from_rotation_z(std::f64::consts::PI), ..arc[0] };
        assert_eq!(upright(&[arc[0], turned]), None);
    }

    #[test]
    fn it_starts_at_the_camera_and_stays_at_its_height() {
        let eye = DVec3::new(3.0, -2.0, 1.5);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let ring: Vec<Camera> = [0.0, 2.0, 4.0]
            .map(|turn: f64| {
                Camera::look_at(DVec3::new(turn.cos(), turn.sin(), 0.0), DVec3::ZERO, DVec3::Z, 0.7, [4, 3])
            })
            .to_vec();
        let cameras = orbit(&camera, &ring, &Domain::Box(Aabb::centered_cube(1.0)), 8);
        assert!((cameras[0].position - eye).length() < 1e-12);
        for other in &cameras {
            assert!((other.position.z - 1.5).abs() < 1e-12 && (other.position.length() - eye.length()).abs() < 1e-12);
            let ([x, y], _) = other.project(DVec3::ZERO).unwrap();
            assert!((x - 20.0).abs() < 1e-9 && (y - 15.0).abs() < 1e-9, "it looks at the middle");
        }
        assert!((cameras[4].position - DVec3::new(-3.0, 2.0, 1.5)).length() < 1e-12);
        // Looking below the middle, it still turns about the upright axis through it.
        let low = Camera::look_at(eye, DVec3::new(0.0, 0.0, -0.5), DVec3::Z, 0.7, [40, 30]);
        let other = orbit(&low, &ring, &Domain::Box(Aabb::centered_cube(1.0)), 2)[1];
        assert!((other.position - DVec3::new(-3.0, 2.0, 1.5)).length() < 1e-12);
    }
}
