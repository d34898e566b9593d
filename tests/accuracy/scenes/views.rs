//! Scenes that are hard because of the cameras.

use glam::{DVec3, Vec3};

use super::{HardScene, Primitive, Quantity, Rig, Shape, Specimen, Treatment, Verdict, ball, claim, one, waves};

/// All scenes of this module.
pub fn all() -> Vec<HardScene> {
    vec![one_camera(), two_cameras(), no_camera(), camera_inside()]
}

fn seen_from(viewpoints: Vec<(DVec3, DVec3)>) -> Rig {
    Rig { viewpoints, fov_x: 0.5, resolution: [64, 64] }
}

const EYE: DVec3 = DVec3::new(2.6, 0.4, 0.7);

fn one_camera() -> HardScene {
    let rig = seen_from(vec![(EYE, DVec3::ZERO)]);
    HardScene {
        name: "one-camera",
        about: "A textured ball seen by one camera: its front is pinned across the line of sight; along it, moving \
                matter changes a pixel only by what its own colour and density vary, which one picture cannot tell \
                from anything else.",
        field: Specimen::new(one("one-camera", ball()), Treatment::Exact, rig),
        verdict: Verdict::Limit,
        claims: vec![claim("the front is pinned", Quantity::Block, 2.4..=3.5)],
    }
}

fn two_cameras() -> HardScene {
    // 2 degrees apart.
    let turn = glam::DMat3::from_rotation_z(2_f64.to_radians());
    let rig = seen_from(vec![(EYE, DVec3::ZERO), (turn * EYE, DVec3::ZERO)]);
    HardScene {
        name: "two-cameras",
        about: "The same ball seen by two cameras two degrees apart: a Laplace approximation takes them for twice the \
                pictures of one, not for a stereo pair.",
        field: Specimen::new(one("two-cameras", ball()), Treatment::Exact, rig),
        verdict: Verdict::Limit,
        claims: vec![claim("the front is pinned", Quantity::Block, 2.4..=3.5)],
    }
}

fn no_camera() -> HardScene {
    let rig = seen_from(vec![(EYE, 2.0 * EYE), (-EYE, -2.0 * EYE)]);
    HardScene {
        name: "no-camera",
        about: "A ball that two cameras turn their backs on: U is the prior everywhere, to the last bit.",
        field: Specimen::new(one("no-camera", ball()), Treatment::Exact, rig),
        verdict: Verdict::Handled,
        claims: vec![
            claim("nothing is pinned", Quantity::Diagonal, 0.0..=0.0),
            claim("no vertex moves", Quantity::Lowered, 0.0..=0.0),
        ],
    }
}

fn camera_inside() -> HardScene {
    let cloud = Primitive {
        shape: Shape::Fog { center: Vec3::ZERO, radius: 0.9 },
        peak: 8.0,
        softness: 0.0,
        texture: waves(6.0),
    };
    let inside = |x: f64, y: f64, z: f64| (DVec3::new(x, y, z), DVec3::new(4.0 * x, 4.0 * y, -z));
    let rig = Rig {
        viewpoints: vec![inside(0.2, 0.0, 0.1), inside(-0.1, 0.2, -0.1), inside(-0.1, -0.2, 0.05)],
        fov_x: 1.6,
        resolution: [64, 64],
    };
    HardScene {
        name: "camera-inside",
        about: "Cameras inside a cloud: rays begin in the middle of density, and the nearest matter is seen best.",
        field: Specimen::new(one("camera-inside", cloud), Treatment::Exact, rig),
        verdict: Verdict::Handled,
        claims: vec![claim("what is near is pinned", Quantity::Block, 2.5..=3.8)],
    }
}
