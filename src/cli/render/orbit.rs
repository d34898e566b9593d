//! Cameras on a circle.

use glam::{DMat3, DQuat, DVec3};

use crate::geometry::{Camera, Domain};

/// `count` cameras like `start`, turned in equal steps about the upright axis through what it looks at.
///
/// Upright is what is up in most of `others`. What it looks at is the point of its optical axis next to the middle of
/// `domain`.
pub fn orbit(start: &Camera, others: &[Camera], domain: &Domain, count: u32) -> Vec<Camera> {
    let up: DVec3 = others.iter().map(|camera| camera.axes.y_axis).sum();
    // Cameras all around, upside down too, have none.
    let up = if up.length() > 0.05 * others.len() as f64 { up.normalize() } else { start.axes.y_axis };
    let middle = match domain {
        Domain::Box(bounds) => 0.5 * (bounds.min() + bounds.max()),
        Domain::Contracted { center, .. } => DVec3::from(*center),
    };
    let ahead = -start.axes.z_axis;
    let distance = ahead.dot(middle - start.position).max(0.0);
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
    }
}
