//! Scenes that are hard because of the box: what touches it, how little it contains, where it lies.

use glam::{DVec3, Vec3};

use super::{
    CELL, HardScene, Primitive, Quantity, Shape, Specimen, Treatment, Verdict, ball, claim, one, several, waves,
};
use super::{Rig, ring};

/// All scenes of this module.
pub fn all() -> Vec<HardScene> {
    let moved = [tiny(), huge(), shifted()].into_iter().flatten();
    [face_density(), empty(), one_cell()].into_iter().chain(moved).collect()
}

fn face_density() -> HardScene {
    // Thicker than the box.
    let shape = Shape::Slab { center: Vec3::ZERO, normal: Vec3::X, half: 2.0 };
    let block = Primitive { shape, peak: 6.0, softness: 0.0, texture: waves(6.0) };
    HardScene {
        name: "face-density",
        about: "The box is full to the brim: density ends at its faces. They are no surfaces, as nothing beyond is \
                known: derivatives look inwards only, and the density, which is constant, pins nothing; texture does.",
        field: Specimen::new(one("face-density", block), Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("texture is pinned", Quantity::Block, 1.7..=2.8)],
    }
}

fn empty() -> HardScene {
    HardScene {
        name: "empty",
        about: "Nothing at all: U is the prior everywhere, to the last bit, and that is no error.",
        field: Specimen::new(several("empty", Vec::new()), Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        claims: vec![
            claim("nothing is pinned", Quantity::Diagonal, 0.0..=0.0),
            claim("no vertex moves", Quantity::Lowered, 0.0..=0.0),
        ],
    }
}

fn one_cell() -> HardScene {
    let center = Vec3::splat(0.5 * CELL);
    let shape = Shape::Ball { center, radius: 0.3 * CELL };
    let pea = Primitive { shape, peak: 2000.0, softness: 0.1 * CELL, texture: waves(150.0) };
    let viewpoints = ring().viewpoints.into_iter().map(|(eye, _)| (eye, center.as_dvec3())).collect();
    HardScene {
        name: "one-cell",
        about: "All matter within one cell, far from its faces: the cell's eight corners move, and nothing else.",
        field: Specimen::new(
            one("one-cell", pea).with_step(f64::from(CELL) / 32.0),
            Treatment::Exact,
            Rig { viewpoints, fov_x: 0.03, resolution: [64, 64] },
        ),
        verdict: Verdict::Handled,
        claims: vec![
            claim("they are pinned", Quantity::Block, 4.8..=5.9),
            claim("eight vertices move", Quantity::Lowered, 8.0 / 35_937.0..=8.0 / 35_937.0),
        ],
    }
}

/// The usual ball, scaled and shifted.
///
/// # Errors
/// If its box would no longer be valid.
pub fn moved_ball(scale: f64, shift: DVec3) -> octobayes::Result<Specimen> {
    Specimen::new(one("moved ball", ball()), Treatment::Exact, ring()).moved(scale, shift)
}

fn moved(
    name: &'static str,
    about: &'static str,
    (scale, shift): (f64, DVec3),
    verdict: Verdict,
) -> octobayes::Result<HardScene> {
    let claims = match verdict {
        Verdict::Refused => Vec::new(),
        _ => vec![claim("as much is pinned as at the usual size", Quantity::Block, 2.2..=3.5)],
    };
    Ok(HardScene { name, about, field: moved_ball(scale, shift)?, verdict, claims })
}

fn tiny() -> octobayes::Result<HardScene> {
    let about = "A ball in micrometres: lengths are a millionth, densities a million times the usual. U is a \
                 millionth, too: the prior is tied to the box.";
    moved("tiny", about, (1e-6, DVec3::ZERO), Verdict::Handled)
}

fn huge() -> octobayes::Result<HardScene> {
    moved("huge", "The same ball a million times larger than usual: so is U.", (1e6, DVec3::ZERO), Verdict::Handled)
}

fn shifted() -> octobayes::Result<HardScene> {
    let about = "The ball 100,000 units from the origin: f32 positions there are 1/128 apart, an eighth of a \
                 cell, and 16 times the step of the finite differences, which would see no difference at all. \
                 Move the scene to the origin.";
    moved("shifted", about, (1.0, DVec3::new(1e5, -1e5, 1e5)), Verdict::Refused)
}
