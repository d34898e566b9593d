//! Camera positions on a golden spiral over the upper hemisphere, or over a part of it.
//!
//! Camera n of N has height z = (n + ½)/N of the range and azimuth n/φ + turn of the range, where φ is the golden
//! ratio. The cameras are evenly spread by area, and consecutive ones are far apart. Front is −y, right is +x.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::mesh::{HALF_HEIGHT, RADIUS};
use super::trace::GROUND_RADIUS;
use octobayes::geometry::Camera;
use octobayes_data::Hemisphere;

/// The point that cameras look at.
///
/// It is the centre of the smallest ball around the ground's rim and the top of what a mesh may fill; the radius of
/// that ball is 1.144.
pub const TARGET: DVec3 = DVec3::new(0.0, 0.0, (RADIUS * RADIUS - GROUND_RADIUS * GROUND_RADIUS) / (4.0 * HALF_HEIGHT));
/// Distance of the cameras from [`TARGET`]. With [`ANGLE`], the ball is in view from
/// 1.144 / sin(ANGLE / 2) = 3.38 on.
pub const DISTANCE: f64 = 3.4;
/// Angle of view along the image's shorter side in radians, as in NeRF-synthetic.
pub const ANGLE: f64 = 0.691_111_2;
/// Lowest and highest sine of the elevation. The ground does not become a line, and "up" stays defined.
const SINE: [f64; 2] = [0.06, 0.97];

/// Azimuths of a half from +x towards +y, start and width, radians.
fn azimuths(half: Hemisphere) -> [f64; 2] {
    match half {
        Hemisphere::Right => [-FRAC_PI_2, PI],
        Hemisphere::Back => [0.0, PI],
        Hemisphere::Left => [FRAC_PI_2, PI],
        Hemisphere::Front => [PI, PI],
    }
}

/// Places `count` cameras that look at [`TARGET`] from above the ground, all around or in one half. `seed` turns the
/// spiral.
#[must_use]
pub fn viewpoints(count: u32, half: Option<Hemisphere>, resolution: [u32; 2], seed: u64) -> Vec<Camera> {
    let [start, width] = half.map_or([0.0, TAU], azimuths);
    let turn: f64 = ChaCha8Rng::seed_from_u64(seed).random();
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    // `look_at` takes the horizontal angle.
    let [w, h] = resolution.map(f64::from);
    let angle_x = 2.0 * ((0.5 * ANGLE).tan() * (w / w.min(h))).atan();
    (0..count)
        .map(|n| {
            let azimuth = start + width * (f64::from(n) * golden + turn).fract();
            let sine = SINE[0] + (SINE[1] - SINE[0]) * (f64::from(n) + 0.5) / f64::from(count);
            let level = (1.0 - sine * sine).sqrt();
            let eye = TARGET + DISTANCE * DVec3::new(level * azimuth.cos(), level * azimuth.sin(), sine);
            Camera::look_at(eye, TARGET, DVec3::Z, angle_x, resolution)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_halves_and_nothing_is_cut_off() {
        let sides = [
            (Some(Hemisphere::Left), -DVec3::X),
            (Some(Hemisphere::Right), DVec3::X),
            (Some(Hemisphere::Front), -DVec3::Y),
            (Some(Hemisphere::Back), DVec3::Y),
            (None, DVec3::Z),
        ];
        for (half, side) in sides {
            for resolution in [[60, 60], [80, 40], [40, 80]] {
                let cameras = viewpoints(50, half, resolution, 7);
                assert_eq!(cameras.len(), 50);
                for camera in cameras {
                    assert!(camera.position.dot(side) > 0.0, "{half:?}: {}", camera.position);
                    assert!((camera.position.distance(TARGET) - DISTANCE).abs() < 1e-12);
                    for i in 0..100 {
                        let angle = f64::from(i) * TAU / 100.0;
                        for (r, z) in [(GROUND_RADIUS, -HALF_HEIGHT), (RADIUS, HALF_HEIGHT)] {
                            let rim = DVec3::new(r * angle.cos(), r * angle.sin(), z);
                            let [x, y] = camera.project(rim).unwrap().0;
                            let [w, h] = resolution.map(f64::from);
                            assert!((0.0..w).contains(&x) && (0.0..h).contains(&y), "{rim} is at {x}, {y}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn views_are_spread_over_the_sphere_and_seeds_turn_them() {
        let [a, b] = [0, 1].map(|seed| viewpoints(100, None, [40, 40], seed));
        assert!(a.iter().zip(&b).all(|(a, b)| (a.position - b.position).length() > 1e-3));
        // 100 cameras spread evenly over an area A of the sphere are sqrt(A / 100) apart; half
        // of that is not crowded.
        let area = TAU * (SINE[1] - SINE[0]) * DISTANCE * DISTANCE;
        let even = (area / 100.0).sqrt();
        for (i, x) in a.iter().enumerate() {
            let nearest =
                a.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, y)| (x.position - y.position).length());
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!((0.5 * even..1.5 * even).contains(&nearest), "camera {i}: {nearest} against {even}");
        }
    }
}
