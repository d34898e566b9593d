use octobayes::field::{ClosedForm, Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Norm};

use super::*;

/// A wall at x > 0.6, a ball of thin fog in the air before it, and matter behind all cameras.
struct Room;

const FOG: (Vec3, f32) = (Vec3::new(-0.2, 0.1, 0.0), 0.2);

impl RadianceField for Room {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(1.0)
    }

    fn evaluate(&self, positions: &[Vec3], _directions: &[Vec3], out: &mut [Radiance]) {
        for (x, out) in positions.iter().zip(out) {
            let density = match () {
                () if x.x > 0.6 => 200.0,
                () if x.distance(FOG.0) < FOG.1 => 1.2,
                () if x.x < -0.95 => 200.0,
                () => 0.0,
            };
            *out = Radiance { density, color: Vec3::splat(0.5) };
        }
    }

    fn suggested_step(&self) -> f64 {
        1.0 / 128.0
    }
}

impl TrainedField for Room {}

/// Cameras beside each other, which look along x at the wall.
fn cameras() -> Vec<Camera> {
    let eye = |y: f64| DVec3::new(-0.9, y, 0.0);
    [-0.6, -0.3, 0.0, 0.3, 0.6].map(|y| Camera::look_at(eye(y), DVec3::X, DVec3::Z, 1.0, [48, 48])).to_vec()
}

fn cleaned(model: &dyn Model, cameras: &[Camera]) -> CleanedVolume {
    let cells = Cells::new(model.natural_domain(), [32; 3]).unwrap();
    Clean::new(cameras).volume(model, cells).unwrap()
}

#[test]
fn fog_in_the_air_and_what_no_camera_has_in_its_image_go() {
    let cameras = cameras();
    let found = cleaned(&Room, &cameras);
    let removed = found.removed(Strength::Careful);
    let at = |x: Vec3| removed[found.cells.around(x).unwrap()];
    assert_eq!(at(FOG.0), Some(Reason::Floating));
    assert_eq!(at(Vec3::new(-0.97, 0.0, 0.0)), Some(Reason::Unseen));
    for (cell, reason) in removed.iter().enumerate() {
        let x = found.cells.center(cell);
        let is_near_fog = x.distance(FOG.0) < FOG.1 + 2.0 * (2.0 / 32.0) * 3_f32.sqrt();
        match reason {
            // A cell and its neighbours from the fog, which is in no other place.
            Some(Reason::Floating) => assert!(is_near_fog, "{x}"),
            // The cells themselves, and those that touch them.
            Some(Reason::Unseen) => {
                let is_shown = |x: Vec3| cameras.iter().any(|camera| camera.project_inside(x.as_dvec3()).is_some());
                assert!(found.cells.beside(cell).any(|near| !is_shown(found.cells.center(near))), "{x}");
            }
            other => assert_eq!(*other, None, "{x}"),
        }
    }
    // All of the fog but for its rim.
    let fog = (0..found.cells.count()).filter(|&i| found.cells.center(i).distance(FOG.0) < FOG.1 - 0.06);
    assert!(fog.clone().count() > 10 && fog.clone().all(|i| removed[i].is_some()));
    // The inside of the wall is hidden, not unseen.
    assert_eq!(at(Vec3::new(0.9, 0.0, 0.0)), None);
}

#[test]
fn strengths_are_nested_and_threads_do_not_matter() {
    let scene = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(5, [40, 32]);
    let found = cleaned(&scene, &cameras);
    let [careful, normal, strong] = Strength::ALL.map(|strength| found.cleaned.removed(strength));
    for i in 0..found.parts.len() {
        assert!(careful[i].is_none() || careful[i] == normal[i], "{i}");
        assert!(normal[i].is_none() || normal[i] == strong[i], "{i}");
    }
    assert!(found.parts.is_sorted() && found.parts.len() == found.cleaned.scores.len());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = pool.install(|| cleaned(&scene, &cameras));
    assert_eq!((alone.parts, alone.cleaned), (found.parts, found.cleaned));
}

#[test]
fn a_ray_meets_its_light_cell_by_cell() {
    let cells = Cells::new(Domain::Box(Aabb::centered_cube(1.0)), [4; 3]).unwrap();
    let at = |x: f32| Vec3::new(x, 0.1, 0.1);
    // Two samples in a cell, one outside the box, one without weight, a second cell, and back in the first.
    let samples =
        [(-0.9, 0.1, 1.0), (-0.6, 0.2, 2.0), (1.5, 0.1, 2.5), (0.1, 0.0, 2.8), (0.2, 0.3, 3.0), (-0.7, 0.1, 4.0)];
    let found = met(samples.map(|(x, weight, t)| (at(x), weight, t)).into_iter(), cells, 0.5);
    let cell = |x: f32| cells.around(at(x)).unwrap() as u32;
    // What is outside takes no light from what is in the grid: it belongs to none of its cells.
    let expected = [(cell(-0.9), 0.3, (0.1 + 0.4) / 0.3), (cell(0.2), 0.3 / 0.7, 3.0), (cell(-0.7), 0.1 / 0.4, 4.0)];
    assert_eq!(found.len(), expected.len());
    for (found, (part, alpha, t)) in found.iter().zip(expected) {
        assert_eq!(found.part, part);
        // f32.
        assert!((f64::from(found.alpha) - alpha).abs() < 1e-6 && (f64::from(found.depth) - 0.5 * t).abs() < 1e-6);
    }
}

#[test]
fn cells_divide_a_space() {
    let box_of = Domain::Box(Aabb::new(DVec3::new(-1.0, 0.0, 0.0), DVec3::new(1.0, 2.0, 6.0)).unwrap());
    let contracted = Domain::contracted(DVec3::splat(0.5), 2.0, Norm::Linf).unwrap();
    for (domain, edge) in [(box_of, (44.0_f64 / 75.0).sqrt()), (contracted, 8.0 / 5.0)] {
        let cells = Cells::new(domain, [5; 3]).unwrap();
        assert_eq!(cells.count(), 125);
        for cell in [0, 62, 124] {
            assert_eq!(cells.around(cells.center(cell)), Some(cell), "{domain:?}");
        }
        // Of the middle cell, which is not contracted.
        assert!((cells.edge(62) - edge).abs() < 1e-12 * edge, "{}", cells.edge(62));
        assert_eq!([0, 62, 124].map(|cell| cells.beside(cell).count()), [8, 27, 8]);
        assert_eq!(cells.beside(124).min(), Some(93));
    }
    // With other numbers along the axes, x is fastest.
    let cells = Cells::new(box_of, [2, 3, 4]).unwrap();
    assert_eq!([Vec3::new(-0.9, 0.1, 0.1), Vec3::new(0.9, 0.1, 5.9)].map(|x| cells.around(x)), [Some(0), Some(19)]);
    assert!((0..24).all(|cell| cells.around(cells.center(cell)) == Some(cell)));
    assert!(Cells::new(box_of, [4, 0, 4]).is_err() && Cells::new(box_of, [1025, 1, 1]).is_err());
    assert_eq!(Cells::new(box_of, [5; 3]).unwrap().around(Vec3::splat(7.0)), None);
}

#[test]
fn what_cannot_be_cleaned_is_refused() {
    let cells = Cells::new(Domain::Box(Room.bounds()), [8; 3]).unwrap();
    let refused = |cameras: &[Camera]| Clean::new(cameras).volume(&Room, cells).unwrap_err().to_string();
    assert!(refused(&[]).contains("cameras: expected at least one"), "{}", refused(&[]));
    // From outside, away from everything.
    let away = Camera::look_at(DVec3::X * 3.0, DVec3::X * 4.0, DVec3::Z, 1.0, [8, 8]);
    assert!(refused(&[away]).contains("another frame"), "{}", refused(&[away]));
}
