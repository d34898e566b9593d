//! Rankings of views of a few splats, against sums by hand.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3, Quat, Vec3};

use super::*;
use octobayes::estimate::Model;
use octobayes::geometry::{Aabb, Distortion};
use octobayes::render::ImagePoints;
use octobayes_splats::{RenderMode, SplatRenderer, Splats};

/// A ball of splats whose colours depend on the direction.
fn ball() -> Splats {
    let count = 400;
    let normal = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
        let (sin, cos) = (i as f32 * 2.399_963_2).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    Splats::new(
        (0..count).map(|i| 0.7 * normal(i)).collect(),
        vec![Vec3::new(-2.8, -2.9, -4.6); count],
        (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
        (0..count).map(|i| 1.0 + (i % 5) as f32).collect(),
        (0..12 * count).map(|k| ((k * 7) % 11) as f32 / 5.0 - 1.0).collect(),
        1,
        RenderMode::Classic,
    )
    .unwrap()
}

fn grid() -> Lattice {
    Lattice::from_domain(Domain::Box(Aabb::centered_cube(1.0)), 5).unwrap()
}

fn drawn(splats: &Splats) -> SplatRenderer<'_> {
    SplatRenderer::new(splats, RaySettings::default().background)
}

fn dumped(splats: &Splats, cameras: &[Camera]) -> Vec<RaySamples> {
    let source = drawn(splats);
    let viewer = Viewer { cells: grid().coarsened(3), ..viewer(&source) };
    let samples = |camera| {
        evidence::samples(&*source.view(camera, Outputs::Derivatives), &viewer.points(camera), &Silent).unwrap()
    };
    cameras.iter().flat_map(samples).collect()
}

fn trained(samples: &[RaySamples], views: u64) -> UncertaintyField {
    field_on(grid(), samples, views, &MaxLevels::none(5))
}

/// Σ JᵀJ of every lattice point, where the J of a ray there is the sum of its samples' by trilinear weights.
fn by_hand(samples: &[RaySamples]) -> BTreeMap<[u32; 3], DMat3> {
    let mut sums: BTreeMap<[u32; 3], DMat3> = BTreeMap::new();
    for batch in samples {
        for ray in batch.offsets.windows(2) {
            let mut of_ray: BTreeMap<[u32; 3], DMat3> = BTreeMap::new();
            for i in ray[0]..ray[1] {
                let Some(u) = grid().coordinates(batch.positions[i]) else { continue };
                // Columns are axes, rows channels.
                let entry = |channel: usize, axis: usize| f64::from(batch.jacobians[i][3 * channel + axis]);
                let column = |axis: usize| DVec3::new(entry(0, axis), entry(1, axis), entry(2, axis));
                let jacobian = DMat3::from_cols(column(0), column(1), column(2));
                let low = u.floor();
                for corner in 0..8_u32 {
                    let up = [0, 1, 2].map(|axis| corner >> axis & 1);
                    let point = [0, 1, 2].map(|axis| low[axis] as u32 + up[axis]);
                    let weight = |axis: usize| (u - low)[axis] * f64::from(up[axis]);
                    let rest = |axis: usize| (1.0 - (u - low)[axis]) * f64::from(1 - up[axis]);
                    let share: f64 = [0, 1, 2].map(|axis| weight(axis) + rest(axis)).iter().product();
                    *of_ray.entry(point).or_insert(DMat3::ZERO) += jacobian * share;
                }
            }
            for (point, jacobian) in of_ray {
                *sums.entry(point).or_insert(DMat3::ZERO) += jacobian.transpose() * jacobian;
            }
        }
    }
    sums
}

/// ½ log (det (P + ΔP) / det P) or ½ tr(P⁻¹ ΔP) over all points. A ray stands for one pixel: P = S / s² + I / τ².
fn gain_by_hand(training: &BTreeMap<[u32; 3], DMat3>, view: &BTreeMap<[u32; 3], DMat3>, gain: Gain) -> f64 {
    let (prior, noise) = (DMat3::IDENTITY * 0.05_f64.powi(-2), NOISE.powi(-2));
    let of = |(point, delta): (&[u32; 3], &DMat3)| {
        let p = training.get(point).copied().unwrap_or(DMat3::ZERO) * noise + prior;
        let delta = *delta * noise;
        match gain {
            Gain::Trace => 0.5 * (0..3).map(|k| (p.inverse() * delta).col(k)[k]).sum::<f64>(),
            _ => 0.5 * ((p + delta).determinant() / p.determinant()).ln(),
        }
    };
    view.iter().map(of).sum()
}

#[test]
fn gains_of_splats_are_those_of_sums_by_hand() {
    let (splats, cameras) = (ball(), circle());
    let training = dumped(&splats, &cameras[..2]);
    let (field, known) = (trained(&training, 2), by_hand(&training));
    assert!(known.len() > 500, "{} points", known.len());
    for gain in [Gain::Logdet, Gain::Trace] {
        let next = NextView::new(&splats, &field, &cameras[2..]);
        let ranking = next.settings(settings().gain(gain).take(3)).run().unwrap();
        for (camera, found) in cameras[2..].iter().zip(&ranking.gains) {
            let expected = gain_by_hand(&known, &by_hand(&dumped(&splats, &[*camera])), gain);
            // Sums of thousands of terms in another order, and determinants of conditions of up to 1e6.
            assert!((found / expected - 1.0).abs() < 1e-8 && *found > 1.0, "{gain:?}: {found} {expected}");
        }
        // The second is worth what it adds to the first.
        let [first, second] = [0, 1].map(|k| by_hand(&dumped(&splats, &[cameras[2 + ranking.steps[k].index]])));
        let mut both = known.clone();
        first.iter().for_each(|(point, s)| *both.entry(*point).or_insert(DMat3::ZERO) += *s);
        let expected = gain_by_hand(&both, &second, gain);
        assert!((ranking.steps[1].gain / expected - 1.0).abs() < 1e-8, "{gain:?}: {expected}");
    }
}

#[test]
fn the_predicted_deviations_of_splats_are_those_found_once_the_rays_are_added() {
    let (splats, cameras) = (ball(), circle());
    let (training, candidate) = (dumped(&splats, &cameras[..2]), dumped(&splats, &cameras[4..5]));
    let [before, after] = [trained(&training, 2), trained(&[training, candidate].concat(), 3)];
    let (source, precision) = (drawn(&splats), before.precision().unwrap());
    let viewer = Viewer { precision: Some(&precision), cells: grid().coarsened(3), ..viewer(&source) };
    let found = viewer.evidence(&cameras[4], &Silent).unwrap();
    let mut changed = 0;
    for added in &found.added {
        let predicted = matrix(precision.before(added)) + matrix(added.precision);
        let inverse = predicted.inverse();
        let sigma = (0..3).map(|k| inverse.col(k)[k]).sum::<f64>().sqrt();
        let u = morton::decode(added.code).map(f64::from).into();
        let stored = after.query(grid().position(u).as_vec3()).uncertainty;
        // Deviations are stored as f32, and read at a position in f32, a 1e-7 of the box beside the vertex.
        assert!((sigma / stored - 1.0).abs() < 1e-4, "{sigma} {stored}");
        changed += usize::from(before.query(grid().position(u).as_vec3()).uncertainty > 1.1 * sigma);
    }
    assert!(changed > 50, "{changed} deviations of {} that fell", found.added.len());
}

#[test]
fn rankings_of_splats_depend_neither_on_threads_nor_on_laziness() {
    let (splats, cameras) = (ball(), circle());
    let field = trained(&dumped(&splats, &cameras[..1]), 1);
    for gain in [Gain::Logdet, Gain::Trace, Gain::Coverage] {
        let ranked = |threads: usize, rescoring, memory| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let settings = settings().take(4).gain(gain).rescoring(rescoring).memory(memory);
            let next = NextView::new(&splats, &field, &cameras[1..]);
            pool.install(|| next.training(&cameras[..1]).settings(settings).run()).unwrap()
        };
        let [one, two, full, again] = [
            ranked(1, Rescoring::Lazy, 1 << 30),
            ranked(2, Rescoring::Lazy, 1 << 30),
            ranked(2, Rescoring::All, 1 << 30),
            ranked(2, Rescoring::Lazy, 0),
        ];
        assert!(same(&one, &two) && same(&one, &full) && same(&one, &again), "{gain:?}: {one:?} {full:?}");
        assert_eq!((one.steps.len(), full.rescored), (4, 6 + 5 + 4), "{gain:?}");
        // The neighbours of the training camera see least that is new.
        let least = one.gains[1..6].iter().copied().fold(f64::INFINITY, f64::min);
        assert!(one.gains[0] < least && one.gains[6] < least, "{gain:?}: {:?}", one.gains);
    }
}

#[test]
fn a_map_of_splats_is_of_the_views_own_pixels() {
    let (splats, cameras) = (ball(), circle());
    let field = trained(&dumped(&splats, &cameras[..1]), 1);
    let next = NextView::new(&splats, &field, &cameras[4..5]).settings(settings());
    let map = next.map(&cameras[4]).unwrap();
    assert_eq!((map.resolution, map.stride), ([SIDE; 2], 1));
    let known = by_hand(&dumped(&splats, &cameras[..1]));
    let source = drawn(&splats);
    let view = source.view(&cameras[4], Outputs::Derivatives);
    for (column, row) in [(8_u32, 8_u32), (5, 9), (10, 6)] {
        let at = vec![[column, row].map(|i| f64::from(i) + 0.5)];
        let points = ImagePoints { at, jitter: vec![0.5], first: 0 };
        let pixel = by_hand(&view.samples(&[points], &Silent).unwrap());
        let (expected, found) = (gain_by_hand(&known, &pixel, Gain::Logdet), map.gains[(row * SIDE + column) as usize]);
        assert!((f64::from(found) / expected - 1.0).abs() < 1e-6 && found > 0.0, "{found} {expected}");
    }
    // A map of every second pixel has the same values: splats grow by a part of the view's pixels, not of the map's.
    let large = cameras[4].resized([300, 20]);
    let wide = NextView::new(&splats, &field, &cameras[4..5]).settings(settings()).map(&large).unwrap();
    assert_eq!((wide.resolution, wide.stride), ([150, 10], 2));
    let view = source.view(&large, Outputs::Derivatives);
    let points = ImagePoints { at: vec![[150.5, 10.5]], jitter: vec![0.5], first: 0 };
    let pixel = by_hand(&view.samples(&[points], &Silent).unwrap());
    let (expected, found) = (gain_by_hand(&known, &pixel, Gain::Logdet), wide.gains[5 * 150 + 75]);
    assert!((f64::from(found) / expected - 1.0).abs() < 1e-6 && found > 0.0, "{found} {expected}");
}

#[test]
fn views_that_see_no_splat_say_why_and_lenses_that_distort_are_refused() {
    let (splats, cameras) = (ball(), circle());
    let field = trained(&dumped(&splats, &cameras[..1]), 1);
    let past = Camera::look_at(DVec3::new(3.0, 0.0, 0.0), DVec3::new(6.0, 0.0, 0.0), DVec3::Z, 0.8, [SIDE, SIDE]);
    let inside = Camera::look_at(splats.mean(4).as_dvec3(), DVec3::ZERO, DVec3::X, 0.8, [SIDE, SIDE]);
    let middle = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, 0.8, [SIDE, SIDE]);
    let candidates = [past, inside, cameras[4], middle];
    for gain in [Gain::Logdet, Gain::Coverage] {
        let next = NextView::new(&splats, &field, &candidates).training(&cameras[..1]);
        let ranking = next.settings(settings().take(4).gain(gain)).run().unwrap();
        assert_eq!(ranking.blanks, [Some(Blank::PastTheBox), Some(Blank::InMatter), None, None], "{gain:?}");
        assert!(ranking.gains[0] == 0.0 && ranking.gains[1] == 0.0 && ranking.gains[3] > 0.0, "{:?}", ranking.gains);
    }
    let eyes = candidates.map(|camera| camera.position);
    assert_eq!(Model::in_matter(&splats, None, &eyes), [false, true, false, false]);
    let bent = Camera { distortion: Distortion { k: [0.1, 0.0, 0.0, 0.0], p: [0.0; 2] }, ..cameras[4] };
    let next = NextView::new(&splats, &field, &cameras[4..5]).training(&cameras[..1]);
    for refused in [
        NextView::new(&splats, &field, &[bent]).settings(settings()).run().unwrap_err(),
        next.training(&[bent]).settings(settings()).run().unwrap_err(),
    ] {
        assert!(refused.to_string().starts_with("cameras of splats: expected no lens distortion"), "{refused}");
    }
}

#[test]
fn a_side_that_no_training_ray_reached_is_known() {
    let splats = ball();
    let at = |turn: f64| {
        let eye = DVec3::new(2.4 * turn.cos(), 2.4 * turn.sin(), 0.4);
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, [40; 2])
    };
    let sides = [0.3, 0.3 + std::f64::consts::PI].map(at);
    let shares = |cameras: &[Camera]| {
        let run = Estimation::new(&splats, cameras);
        let run = run.rays(RaySettings::default().rays(20_000)).grid(GridSettings::default().level(5));
        let field = run.run().unwrap().field;
        let found = NextView::new(&splats, &field, &sides).unseen().unwrap();
        [0, 1].map(|i| found[i].unwrap())
    };
    let half = shares(&[0.0, 0.3, 0.6].map(at));
    assert!(half[0] < 0.02 && half[1] > 0.5, "{half:?}");
    let round: Vec<Camera> = (0..8).map(|k| at(std::f64::consts::TAU * f64::from(k) / 8.0)).collect();
    assert!(shares(&round).iter().all(|share| *share < 0.1), "{:?}", shares(&round));
}
