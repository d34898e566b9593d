use glam::Quat;
use octobayes::monitor::Silent;
use octobayes_splats::RenderMode;

use super::*;

/// Splats of one size and no colour at these places, with these opacities.
fn splats(placed: &[(Vec3, f32)]) -> Splats {
    let n = placed.len();
    let means = placed.iter().map(|(mean, _)| *mean).collect();
    let logits = placed.iter().map(|(_, opacity)| (opacity / (1.0 - opacity)).ln()).collect();
    let (scales, rotations) = (vec![Vec3::splat(-3.0); n], vec![Quat::IDENTITY; n]);
    Splats::new(means, scales, rotations, logits, vec![0.0; 3 * n], 0, RenderMode::Classic).unwrap()
}

/// A camera at the origin that looks along x, through the middle of its only pixel.
fn look(splats: &Splats) -> Evidence {
    let camera = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 0.02, [1, 1]);
    Evidence::measure(splats, &[camera], 0.5, 1, &Silent).unwrap().0
}

fn shares(of: &Evidence) -> Vec<f64> {
    (0..of.weight.len()).map(|i| of.front_share(i)).collect()
}

#[test]
fn what_is_nearer_than_half_of_the_light_is_in_front() {
    let at = |x: f32, opacity: f32| (Vec3::X * x, opacity);
    // Shares 0.3, 0.7 · 0.9 and less: half of 0.9… is reached at the second.
    let seen = look(&splats(&[at(4.0, 0.9), at(2.0, 0.3), at(5.0, 0.8), at(3.985, 0.01)]));
    let expected = [0.7 * 0.99 * 0.9, 0.3, 0.7 * 0.99 * 0.1 * 0.8, 0.7 * 0.01];
    for (found, expected) in seen.weight.iter().zip(expected) {
        // The pixel looks at the splats' centres; opacities are logits in f32.
        assert!((found - expected).abs() < 1e-6, "{:?}", seen.weight);
    }
    // The fourth is nearer by less than a hundredth.
    assert_eq!(shares(&seen), [0.0, 1.0, 0.0, 0.0]);
    // Most of the light passes these: alone, they may be what an object is made of.
    let thin = look(&splats(&[at(4.0, 0.2), at(2.0, 0.3)]));
    assert_eq!((shares(&thin), thin.free_share(0), thin.before), (vec![0.0; 2], 1.0, vec![1; 2]));
    // Behind the camera.
    let unseen = look(&splats(&[at(-4.0, 0.9)]));
    assert_eq!((shares(&unseen), unseen.weight, unseen.inside), (vec![0.0], vec![0.0], vec![0]));
}

#[test]
fn the_share_is_that_of_all_pixels_together() {
    // A small floater before the left half of a wall, whose right half it does not touch.
    let wall = (0..400).map(|i| (Vec3::new(4.0, (i % 20) as f32 / 10.0 - 1.0, (i / 20) as f32 / 10.0 - 1.0), 0.95));
    let placed: Vec<_> = wall.chain([(Vec3::new(2.0, 0.25, 0.0), 0.4)]).collect();
    let cameras =
        [0.0, 0.1, -0.1].map(|y| Camera::look_at(DVec3::new(0.0, y, 0.0), DVec3::X * 4.0, DVec3::Z, 0.45, [32, 32]));
    let (seen, pixels) = Evidence::measure(&splats(&placed), &cameras, 0.5, u64::MAX, &Silent).unwrap();
    let front = shares(&seen);
    assert!(front[400] > 0.99 && seen.views[400] == 3 && pixels == 3 * 32 * 32, "{} in front", front[400]);
    assert!(front[..400].iter().all(|front| *front < 0.05), "the wall");
}

#[test]
fn what_lies_behind_a_list_that_ended_is_not_known() {
    // Two splats take all but 10⁻⁴ of the light; without them the list has nothing left.
    let listed = |part: u32| Listed { part, alpha: 0.99, depth: 2.0 + part as f32 };
    let hits = [listed(0), listed(1)];
    let surface = |kept: [bool; 2]| {
        let mut shares = Vec::new();
        (composite(&hits, &kept, &mut shares), shares.len())
    };
    assert_eq!((surface([true; 2]), surface([false, true])), ((2.0, 2), (3.0, 1)));
    assert!(surface([false; 2]).0.is_nan());
    // A thin one may be looked through: there was nothing behind.
    let thin = [Listed { alpha: 0.6, ..listed(0) }];
    assert!(composite(&thin, &[false], &mut Vec::new()).is_infinite());
}
