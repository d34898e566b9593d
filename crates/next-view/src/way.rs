//! How a photographer gets from one camera to another, in words that need no axes.

use std::fmt;

use glam::DVec3;
use octobayes::geometry::Camera;

/// Steps of less than this share of the whole way are left out.
const SLIGHT: f64 = 0.1;
/// Turns of less are left out, degrees.
const SLIGHT_TURN: f64 = 5.0;

/// The way from one camera to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Way {
    /// To the right, ahead and up as the first camera was held, level: scene units.
    pub steps: DVec3,
    /// How far to turn to the right on the spot, degrees from -180 to 180.
    pub turn: f64,
    /// How far the second camera looks up, degrees; down if negative.
    pub pitch: f64,
}

impl Way {
    /// From camera `from` to camera `to`, where `up` is a unit vector.
    #[must_use]
    pub fn between(from: &Camera, to: &Camera, up: DVec3) -> Self {
        let ahead = Self::level(from, up);
        let right = ahead.cross(up);
        let moved = to.position - from.position;
        let steps = DVec3::new(moved.dot(right), moved.dot(ahead), moved.dot(up));
        let other = Self::level(to, up);
        let turn = other.dot(right).atan2(other.dot(ahead)).to_degrees();
        let pitch = (-to.axes.z_axis).dot(up).clamp(-1.0, 1.0).asin().to_degrees();
        Self { steps, turn, pitch }
    }

    /// Where a camera looks, without what it looks up or down; where the top of its image is if it looks straight down
    /// or up. A unit vector.
    #[must_use]
    pub fn level(camera: &Camera, up: DVec3) -> DVec3 {
        let [ahead, top] = [-camera.axes.z_axis, camera.axes.y_axis].map(|v| v.reject_from_normalized(up));
        let is_steep = ahead.length() < 0.05;
        (if is_steep { top } else { ahead }).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector())
    }

    /// In words, such as `1.2 m to the left, 0.4 m higher; turn 30° to the right, look down 20°`. `length` writes
    /// lengths of scene units.
    #[must_use]
    pub fn words(&self, length: impl Fn(f64) -> String) -> String {
        let names = [["to the left", "to the right"], ["back", "ahead"], ["lower", "higher"]];
        let far = self.steps.length();
        let step = |(v, [less, more]): (f64, [&str; 2])| {
            (v.abs() >= SLIGHT * far && v != 0.0)
                .then(|| format!("{} {}", length(v.abs()), if v < 0.0 { less } else { more }))
        };
        let steps: Vec<String> = self.steps.to_array().into_iter().zip(names).filter_map(step).collect();
        let place = if steps.is_empty() { "the same place".to_owned() } else { steps.join(", ") };
        let turned = |angle: f64, [less, more]: [&str; 2]| {
            let way = if angle < 0.0 { less } else { more };
            (angle.abs() >= SLIGHT_TURN).then(|| way.replace('_', &format!("{:.0}°", angle.abs())))
        };
        let turn = turned(self.turn, ["turn _ to the left", "turn _ to the right"]);
        let pitch = turned(self.pitch, ["look down _", "look up _"]).unwrap_or("hold it level".into());
        let view: Vec<String> = turn.into_iter().chain([pitch]).collect();
        format!("{place}; {}", view.join(", "))
    }
}

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.words(|v| format!("{v:.3} scene units")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looking(eye: [f64; 3], target: [f64; 3]) -> Camera {
        Camera::look_at(eye.into(), target.into(), DVec3::Z, 0.8, [4, 4])
    }

    #[test]
    fn ways_are_those_of_a_photographer() {
        let from = looking([0.0, -3.0, 1.0], [0.0, 0.0, 1.0]);
        // Ahead is y, right is x. Two to the left and one higher, looking along x and down by 45 degrees.
        let to = looking([-2.0, -3.0, 2.0], [0.0, -3.0, 0.0]);
        let way = Way::between(&from, &to, DVec3::Z);
        assert!(way.steps.distance(DVec3::new(-2.0, 0.0, 1.0)) < 1e-12, "{way:?}");
        assert!((way.turn - 90.0).abs() < 1e-9 && (way.pitch + 45.0).abs() < 1e-9, "{way:?}");
        let words = way.words(|v| format!("{:.1} m", 0.5 * v));
        assert_eq!(words, "1.0 m to the left, 0.5 m higher; turn 90° to the right, look down 45°");
        let back = Way::between(&to, &from, DVec3::Z);
        assert!((back.turn + 90.0).abs() < 1e-9 && back.pitch.abs() < 1e-9);
        // The second one looks along x: the first stands two ahead of it and one lower.
        assert!(back.steps.distance(DVec3::new(0.0, 2.0, -1.0)) < 1e-12, "{back:?}");
        assert_eq!(Way::between(&from, &from, DVec3::Z).to_string(), "the same place; hold it level");
    }

    #[test]
    fn a_camera_that_looks_straight_down_is_level_by_the_top_of_its_image() {
        let mut down = looking([0.0, 0.0, 3.0], [0.0, 1e-9, 0.0]);
        down.axes = glam::DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::Z);
        let way = Way::between(&down, &looking([1.0, 1.0, 3.0], [1.0, 2.0, 3.0]), DVec3::Z);
        assert!(way.steps.distance(DVec3::new(1.0, 1.0, 0.0)) < 1e-9 && way.turn.abs() < 1e-6, "{way:?}");
    }
}
