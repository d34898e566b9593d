//! Cameras on a circle.

use glam::{DMat3, DQuat, DVec3};

use crate::geometry::{Camera, Domain};

/// `count` cameras like `start`, turned in equal steps about the upright axis through what it looks at.
///
/// What it looks at is the point of its optical axis next to the axis `up` through the middle of `domain`.
pub fn orbit(start: &Camera, up: DVec3, domain: &Domain, count: u32) -> Vec<Camera> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn it_starts_at_the_camera_and_stays_at_its_height() {
        let eye = DVec3::new(3.0, -2.0, 1.5);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, [40, 30]);
        let cameras = orbit(&camera, DVec3::Z, &Domain::Box(Aabb::centered_cube(1.0)), 8);
        assert!((cameras[0].position - eye).length() < 1e-12);
        for other in &cameras {
            assert!((other.position.z - 1.5).abs() < 1e-12 && (other.position.length() - eye.length()).abs() < 1e-12);
            let ([x, y], _) = other.project(DVec3::ZERO).unwrap();
            assert!((x - 20.0).abs() < 1e-9 && (y - 15.0).abs() < 1e-9, "it looks at the middle");
        }
        assert!((cameras[4].position - DVec3::new(-3.0, 2.0, 1.5)).length() < 1e-12);
        // Looking below the middle, it still turns about the upright axis through it.
        let low = Camera::look_at(eye, DVec3::new(0.0, 0.0, -0.5), DVec3::Z, 0.7, [40, 30]);
        let other = orbit(&low, DVec3::Z, &Domain::Box(Aabb::centered_cube(1.0)), 2)[1];
        assert!((other.position - DVec3::new(-3.0, 2.0, 1.5)).length() < 1e-12);
    }
}
