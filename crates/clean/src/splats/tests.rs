use glam::{DVec3, Quat};
use octobayes::geometry::Mask;
use octobayes_splats::RenderMode;

use super::*;
use crate::{Reason, Strength};

/// A splat of a deviation and an opacity at a place.
type Placed = (Vec3, f32, f32);

fn splats(placed: &[Placed]) -> Splats {
    let n = placed.len();
    let means = placed.iter().map(|(mean, ..)| *mean).collect();
    let scales = placed.iter().map(|(_, scale, _)| Vec3::splat(scale.ln())).collect();
    let logits = placed.iter().map(|(.., opacity)| (opacity / (1.0 - opacity)).ln()).collect();
    Splats::new(means, scales, vec![Quat::IDENTITY; n], logits, vec![0.0; 3 * n], 0, RenderMode::Classic).unwrap()
}

/// An opaque wall of 20 × 20 splats at x = 4, two wide and high.
fn wall() -> Vec<Placed> {
    let at = |i: u16| Vec3::new(4.0, f32::from(i % 20) / 10.0 - 1.0, f32::from(i / 20) / 10.0 - 1.0);
    (0..400).map(|i| (at(i), 0.08, 0.98)).collect()
}

/// Cameras beside each other at x = 0, which look at the middle of the wall.
fn cameras(places: &[f64]) -> Vec<Camera> {
    let look = |y: &f64| Camera::look_at(DVec3::new(0.0, *y, 0.0), DVec3::X * 4.0, DVec3::Z, 0.6, [48, 48]);
    places.iter().map(look).collect()
}

const BESIDE: [f64; 5] = [-0.6, -0.3, 0.0, 0.3, 0.6];

/// Why the splats behind those of the wall go.
fn reasons(extra: &[Placed], strength: Strength) -> Vec<Option<Reason>> {
    let placed = [wall(), extra.to_vec()].concat();
    let cleaned = Clean::new(&cameras(&BESIDE)).splats(&splats(&placed)).unwrap();
    let removed = cleaned.removed(strength);
    assert!(removed[..400].iter().all(Option::is_none), "the wall stays: {:?}", cleaned.counts(strength));
    removed[400..].to_vec()
}

#[test]
fn every_reason_has_its_splats() {
    let extra = [
        // In the air between cameras and wall.
        (Vec3::new(2.0, 0.1, 0.1), 0.05, 0.4),
        // Behind the wall.
        (Vec3::new(5.0, 0.0, 0.0), 0.05, 0.9),
        // Behind all cameras.
        (Vec3::new(-3.0, 0.0, 0.0), 0.05, 0.9),
        // A thousand scenes away, as a star above the wall.
        (Vec3::new(4000.0, 0.0, 1150.0), 5.0, 0.9),
        // On the wall, but not to be seen.
        (Vec3::new(4.0, 0.2, 0.2), 0.05, 0.003),
        // On the wall.
        (Vec3::new(3.99, -0.2, 0.2), 0.05, 0.4),
    ];
    let expected = [
        Some(Reason::Floating),
        Some(Reason::Unseen),
        Some(Reason::Unseen),
        Some(Reason::Outside),
        Some(Reason::Transparent),
        None,
    ];
    for strength in Strength::ALL {
        assert_eq!(reasons(&extra, strength), expected, "{strength}");
    }
}

#[test]
fn a_floater_that_hides_another_goes_first() {
    // For the middle camera the two together are more than half of the light: the farther one is the surface there.
    let extra = [(Vec3::new(1.0, 0.0, 0.0), 0.04, 0.45), (Vec3::new(2.0, 0.0, 0.0), 0.06, 0.35)];
    assert_eq!(reasons(&extra, Strength::Strong), [Some(Reason::Floating); 2]);
}

#[test]
fn what_most_views_show_as_the_surface_stays() {
    // A small object before the wall hides it in all views: opaque, and as large as several pixels.
    let ball = |i: u16| {
        let [a, b] = [i % 8, i / 8].map(|k| f32::from(k) / 40.0 - 0.1);
        (Vec3::new(3.0, a, b), 0.03, 0.98)
    };
    let object: Vec<Placed> = (0..64).map(ball).collect();
    assert_eq!(reasons(&object, Strength::Strong), [None; 64]);
}

#[test]
fn strengths_are_nested_and_counts_agree() {
    let cloud = |i: u16| {
        let [a, b, c] = [0.755, 0.570, 0.430].map(|step| (f32::from(i) * step).fract());
        (Vec3::new(1.5 + 2.4 * a, b - 0.5, c - 0.5), 0.05, 0.05 + 0.4 * (a + b).fract())
    };
    let placed = [wall(), (0..200).map(cloud).collect()].concat();
    let (splats, cameras) = (splats(&placed), cameras(&BESIDE));
    let cleaned = Clean::new(&cameras).splats(&splats).unwrap();
    let [careful, normal, strong] = Strength::ALL.map(|strength| cleaned.removed(strength));
    for i in 0..splats.len() {
        assert!(careful[i].is_none() || careful[i] == normal[i], "{i}");
        assert!(normal[i].is_none() || normal[i] == strong[i], "{i}");
    }
    let all: Vec<usize> = Strength::ALL.iter().map(|&strength| cleaned.counts(strength).iter().sum()).collect();
    assert!(0 < all[0] && all[0] < all[1] && all[1] < all[2] && all[2] <= 200, "{all:?}");
    // Nothing depends on threads or on how often it is run.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| Clean::new(&cameras).splats(&splats).unwrap()), cleaned);
}

#[test]
fn fewer_pixels_find_nearly_the_same() {
    let extra =
        (0..40).map(|i| (Vec3::new(2.0, f32::from(i % 8_u8) / 10.0 - 0.4, f32::from(i / 8) / 10.0 - 0.2), 0.04, 0.3));
    let placed = [wall(), extra.collect()].concat();
    let (splats, cameras) = (splats(&placed), cameras(&BESIDE));
    for pixels in [u64::MAX, 2_000] {
        let cleaned = Clean::new(&cameras).pixels(pixels).splats(&splats).unwrap();
        assert_eq!(cleaned.counts(Strength::Normal)[Reason::Floating as usize], 40, "{pixels} pixels");
        assert!(cleaned.pixels[0] <= pixels && cleaned.pixels[1] == 5 * 48 * 48, "{:?}", cleaned.pixels);
    }
}

#[test]
fn thin_things_between_the_pixels_that_are_looked_at_stay() {
    // A wire of opaque splats before the wall, a tenth of a step thick.
    let wire = (0..400).map(|i| (Vec3::new(3.0, -0.4 + 0.002 * i as f32, 0.11), 0.004, 0.98));
    let placed = [wall(), wire.collect()].concat();
    let (splats, cameras) = (splats(&placed), cameras(&BESIDE));
    for pixels in [u64::MAX, 500] {
        let cleaned = Clean::new(&cameras).pixels(pixels).splats(&splats).unwrap();
        let gone = cleaned.removed(Strength::Careful)[400..].iter().flatten().count();
        assert!(gone < 4, "{gone} of 400 with {pixels} pixels");
    }
}

#[test]
fn views_that_do_not_fit_are_refused() {
    let splats = splats(&wall());
    let cameras = cameras(&[0.0, 0.1]);
    let refused = |masks: &[Option<Mask>]| Clean::new(&cameras).masks(masks).splats(&splats).unwrap_err().to_string();
    let expected = "masks: expected a mask or none for each camera, of its size: [[48, 48], [48, 48]], found ";
    assert_eq!(refused(&[None]), format!("{expected}[None]"));
    let small = Mask::new([8, 8], |_, _| true);
    assert_eq!(refused(&[None, Some(small)]), format!("{expected}[None, Some([8, 8])]"));
}

#[test]
fn a_mask_leaves_its_pixels_out() {
    let placed = [wall(), vec![(Vec3::new(2.0, 0.0, 0.0), 0.02, 0.5)]].concat();
    let (splats, cameras) = (splats(&placed), cameras(&[0.0]));
    let found = |masks: &[Option<Mask>]| {
        let cleaned = Clean::new(&cameras).masks(masks).splats(&splats).unwrap();
        (cleaned.evidence.weight[400], cleaned.evidence.inside[400])
    };
    let whole = found(&[]);
    assert!(whole.0 > 1.0 && whole.1 == 1, "{whole:?}");
    // Without the middle of the image, where the splat is.
    let mask = Mask::new([48, 48], |column, row| column.abs_diff(24) > 5 || row.abs_diff(24) > 5);
    assert_eq!(found(&[Some(mask.clone())]), (0.0, 0));
    // It is not known whether the view shows it.
    let cleaned = Clean::new(&cameras).masks(&[Some(mask)]).splats(&splats).unwrap();
    assert_eq!(cleaned.removed(Strength::Careful)[400], None);
}

#[test]
fn scenes_that_the_cameras_do_not_show_are_refused() {
    let splats = splats(&wall());
    let error = Clean::new(&[]).splats(&splats).unwrap_err().to_string();
    assert!(error.starts_with("cameras: expected at least one"), "{error}");
    let away = [Camera::look_at(DVec3::ZERO, -DVec3::X, DVec3::Z, 0.4, [16, 16])];
    let error = Clean::new(&away).splats(&splats).unwrap_err().to_string();
    assert!(error.contains("found none of 400 parts in its place"), "{error}");
}
