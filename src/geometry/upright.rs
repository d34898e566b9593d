//! What is up, by cameras that were held level.

use glam::{DMat3, DVec3};

use super::Camera;
use crate::{Error, Result};

/// Sines of the roll up to which a camera counts in full, round by round: cameras that were turned on their side then
/// lose their weight, whatever the first rounds make of them. Half of the cameras always count.
const ROLLS: [f64; 6] = [0.5, 0.25, 0.12, 0.06, 0.03, 0.015];
/// Poses are not better than this, radians.
const NOISE: f64 = 1e-3;
/// Largest standard deviation of the axis that right axes agree on, radians: else they are too much alike.
const MAX_DEVIATION: f64 = 0.1;
/// Right axes of this mean square spread and more turn with the cameras; those of less may turn with rolls.
const MIN_SPREAD: f64 = 0.05;
/// Ends of an axis are distinguished by a mean that is at least this much along it; of narrow rigs, by so much of it.
const LEAN: [f64; 2] = [0.05, 0.34];
/// Cameras look along the axis if the mean of where they look is at least this much of it.
const STRAIGHT: f64 = 0.97;
/// What is up in images that look the same way has a mean of this length.
const MIN_AGREEMENT: f64 = 0.92;

/// What is up for `cameras`, a unit vector: `given`, if it is, or else the direction to which what is right
/// in their images is most nearly perpendicular, however far they look down.
///
/// The mean of what is up in images is tilted wherever cameras on one side look down. It decides which end of the axis
/// is up; it is the answer for one camera, and for several that look the same way. If cameras look straight down, up is
/// where they stand. A few cameras that were rolled do not count.
///
/// # Errors
/// If the direction is zero or not finite, or if none is given and images do not agree on one.
pub fn upright(cameras: &[Camera], given: Option<DVec3>) -> Result<DVec3> {
    if let Some(given) = given {
        let found = || format!("{},{},{}", given.x, given.y, given.z);
        return given.try_normalize().ok_or_else(|| Error::setting("up", "a direction, such as 0,0,1", found()));
    }
    agreed(cameras).ok_or_else(|| {
        let expected = "a direction x,y,z, as the images of the cameras do not agree on what is up";
        Error::setting("up", expected, "none")
    })
}

/// What the images agree on.
fn agreed(cameras: &[Camera]) -> Option<DVec3> {
    let count = cameras.len().max(1) as f64;
    let mean = |axis: fn(&Camera) -> DVec3| cameras.iter().map(axis).sum::<DVec3>() / count;
    let [above, behind] = [mean(|camera| camera.axes.y_axis), mean(|camera| camera.axes.z_axis)];
    if let Some((axis, spread)) = level_axis(cameras) {
        let [lean, straight] = [above.dot(axis), behind.dot(axis)];
        let least = if spread < MIN_SPREAD { LEAN[1] * above.length() } else { LEAN[0] };
        if lean.abs() > least {
            return Some(lean.signum() * axis);
        }
        if spread >= MIN_SPREAD {
            return (straight.abs() > STRAIGHT).then(|| straight.signum() * axis);
        }
    }
    (above.length() > MIN_AGREEMENT).then(|| above.normalize())
}

/// The axis to which right axes are most nearly perpendicular, and their mean square spread around it; `None` if they
/// are too much alike, or turn to all sides.
fn level_axis(cameras: &[Camera]) -> Option<(DVec3, f64)> {
    if cameras.len() < 2 {
        return None;
    }
    let rights = || cameras.iter().map(|camera| camera.axes.x_axis);
    // The mean of r rᵀ with these weights.
    let moments = |weight: &dyn Fn(DVec3) -> f64| {
        let outer = |r: DVec3| DMat3::from_cols(r * r.x, r * r.y, r * r.z);
        let add = |(sum, total): (DMat3, f64), r: DVec3| (sum + outer(r) * weight(r), total + weight(r));
        let (sum, total) = rights().fold((DMat3::ZERO, 0.0), add);
        sum * (1.0 / total.max(f64::MIN_POSITIVE))
    };
    let mut matrix = moments(&|_| 1.0);
    let mut axis = least_axis(matrix);
    for roll in ROLLS {
        let mut found: Vec<f64> = rights().map(|r| r.dot(axis).abs()).collect();
        found.sort_by(f64::total_cmp);
        if roll < ROLLS[0] && found[found.len() / 2] > roll {
            break;
        }
        matrix = moments(&|r| 1.0 / (r.dot(axis).powi(2) + roll * roll));
        axis = least_axis(matrix);
    }
    // The smaller two eigenvalues: the mean squares of rolls, and of how far right axes spread.
    let rolls = axis.dot(matrix * axis);
    let others = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z - rolls;
    let squares = matrix.to_cols_array().iter().map(|m| m * m).sum::<f64>() - rolls * rolls;
    let spread = 0.5 * (others - (2.0 * squares - others * others).max(0.0).sqrt());
    let count = cameras.len() as f64;
    let noise = (rolls * count / (count - 2.0).max(1.0)).max(NOISE * NOISE);
    let is_known = noise < MAX_DEVIATION * MAX_DEVIATION * count * spread;
    (is_known && rolls * if spread < MIN_SPREAD { 10.0 } else { 4.0 } < spread).then_some((axis, spread))
}

/// The eigenvector of a symmetric matrix with its smallest eigenvalue, by powers of the inverse.
fn least_axis(matrix: DMat3) -> DVec3 {
    let mut power = (matrix + DMat3::from_diagonal(DVec3::splat(1e-9))).inverse();
    for _ in 0..12 {
        power = power * power;
        let largest = power.to_cols_array().iter().fold(0.0_f64, |most, entry| most.max(entry.abs()));
        power *= 1.0 / largest.max(f64::MIN_POSITIVE);
    }
    let longer = |a: DVec3, b: DVec3| if b.length_squared() > a.length_squared() { b } else { a };
    longer(longer(power.x_axis, power.y_axis), power.z_axis).normalize_or(DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that stands at an azimuth and elevation, degrees, around an upright axis, and looks at the middle.
    fn standing(up: DVec3, azimuth: f64, elevation: f64) -> Camera {
        let (right, [azimuth, elevation]) = (up.any_orthonormal_vector(), [azimuth, elevation].map(f64::to_radians));
        let level = azimuth.cos() * right + azimuth.sin() * up.cross(right);
        let eye = 3.0 * (elevation.cos() * level + elevation.sin() * up);
        Camera::look_at(eye, DVec3::ZERO, up, 0.8, [4; 2])
    }

    fn rolled(camera: &Camera, degrees: f64) -> Camera {
        Camera { axes: camera.axes * DMat3::from_rotation_z(degrees.to_radians()), ..*camera }
    }

    fn degrees(cameras: &[Camera], up: DVec3) -> f64 {
        agreed(cameras).unwrap().angle_between(up).to_degrees()
    }

    fn ups() -> [DVec3; 3] {
        [DVec3::Z, DVec3::NEG_Y, DVec3::new(0.3, -0.8, 0.5).normalize()]
    }

    #[test]
    fn cameras_on_one_side_that_look_down_are_level() {
        for up in ups() {
            for (half, elevation) in [(60.0, 30.0), (20.0, 60.0), (2.0, 45.0), (90.0, -20.0)] {
                let arc: Vec<Camera> = (0..9)
                    .map(|k| standing(up, half * (f64::from(k) - 4.0) / 4.0, elevation + f64::from(k % 3)))
                    .collect();
                assert!(degrees(&arc, up) < 1e-3, "{half} {elevation}");
                // What is right for one is left for another at the opposite side.
                assert!(half > 80.0 || degrees(&[arc[0], arc[8]], up) < 1e-3, "two are enough: {half} {elevation}");
                // The mean of what is up in their images is not.
                let mean = arc.iter().map(|camera| camera.axes.y_axis).sum::<DVec3>();
                assert!(half > 80.0 || mean.angle_between(up).to_degrees() > 20.0);
            }
        }
    }

    #[test]
    fn one_camera_and_those_that_look_the_same_way_are_upright_by_their_images() {
        let one = standing(DVec3::Z, 10.0, 40.0);
        let moved = Camera { position: one.position + DVec3::ONE, ..one };
        for cameras in [vec![one], vec![one, one], vec![one, moved, one]] {
            assert!(degrees(&cameras, one.axes.y_axis) < 1e-6);
        }
        // Rolls of handheld cameras spread right axes, too; their axis is that of sight.
        for turn in [0.0, 0.3, 1.0] {
            let at = |k: u32| standing(DVec3::Z, 10.0 + turn * (f64::from(k % 3) - 1.0), 40.0);
            let wall: Vec<Camera> = (0..9).map(|k| rolled(&at(k), 0.75 * (f64::from(k) - 4.0))).collect();
            assert!(degrees(&wall, one.axes.y_axis) < 1.0, "{turn}: {}", degrees(&wall, one.axes.y_axis));
        }
    }

    #[test]
    fn cameras_that_look_straight_down_stand_above() {
        for up in ups() {
            for headings in [360.0, 90.0] {
                let above: Vec<Camera> = (0..12)
                    .map(|k| {
                        let heading = (headings * f64::from(k) / 12.0).to_radians();
                        let north = heading.cos() * up.any_orthonormal_vector()
                            + heading.sin() * up.cross(up.any_orthonormal_vector());
                        Camera::look_at(5.0 * up, DVec3::ZERO, north, 0.8, [4; 2])
                    })
                    .collect();
                assert!(degrees(&above, up) < 1e-3, "{headings}");
            }
        }
    }

    #[test]
    fn a_few_that_were_rolled_do_not_count() {
        let mut arc: Vec<Camera> = (0..20).map(|k| standing(DVec3::Z, 6.0 * f64::from(k), 35.0)).collect();
        // Upside down is level, too.
        arc[3] = rolled(&arc[3], 180.0);
        for k in [5, 11] {
            arc[k] = rolled(&arc[k], 90.0);
        }
        assert!(degrees(&arc, DVec3::Z) < 0.1, "{}", degrees(&arc, DVec3::Z));
        // All of them a little, to either side.
        let wavering: Vec<Camera> = (0..40)
            .map(|k| rolled(&standing(DVec3::Z, 3.0 * f64::from(k), 35.0), 4.0 * f64::from(k * 7 % 5 - 2)))
            .collect();
        assert!(degrees(&wavering, DVec3::Z) < 3.0, "{}", degrees(&wavering, DVec3::Z));
    }

    #[test]
    fn without_agreement_somebody_has_to_say() {
        let one = standing(DVec3::Z, 0.0, 30.0);
        // Held on their side, all round: what is right in their images is up or down.
        let sideways: Vec<Camera> =
            (0..12).map(|k| rolled(&standing(DVec3::Z, 30.0 * f64::from(k), 20.0), 90.0)).collect();
        for cameras in [vec![], vec![one, rolled(&one, 180.0)], sideways.clone()] {
            assert_eq!(agreed(&cameras), None, "{cameras:?}");
            let error = upright(&cameras, None).unwrap_err().to_string();
            assert!(error.starts_with("up: expected a direction x,y,z"), "{error}");
            assert_eq!(upright(&cameras, Some(2.0 * DVec3::Z)).unwrap(), DVec3::Z);
        }
        assert_eq!(agreed(&sideways[..5]), None, "on one side");
        for given in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY] {
            assert!(upright(&[one], Some(given)).is_err());
        }
    }
}
