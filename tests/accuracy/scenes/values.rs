//! Scenes that are hard because of the numbers that the field returns.

use glam::Vec3;

use super::{HardScene, Quantity, Specimen, Treatment, Verdict, ball, claim, one, ring};

/// All scenes of this module.
pub fn all() -> Vec<HardScene> {
    let mut scenes = vec![aligned(), misaligned(), half_precision()];
    scenes.extend(FAULTS.map(|(name, about, density)| fault(name, about, density)));
    scenes.extend([denormal(), fault_everywhere()]);
    scenes
}

fn aligned() -> HardScene {
    HardScene {
        name: "lattice-aligned",
        about: "A piecewise trilinear field (as a hash grid is) whose cells are the lattice's: its gradient jumps \
                exactly at the vertices. A difference across a kink is the mean of both sides.",
        field: Specimen::new(one("lattice-aligned", ball()), Treatment::Grid { points: 33 }, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("the ball is pinned", Quantity::Block, 2.2..=3.5)],
    }
}

fn misaligned() -> HardScene {
    HardScene {
        name: "lattice-misaligned",
        about: "The same with cells of 2/23, against the lattice's 2/32: its gradient jumps anywhere within a cell.",
        field: Specimen::new(one("lattice-misaligned", ball()), Treatment::Grid { points: 24 }, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("the ball is pinned", Quantity::Block, 2.2..=3.5)],
    }
}

fn half_precision() -> HardScene {
    HardScene {
        name: "half-precision",
        about: "A field that returns f16: a staircase, whose differences over a 256th of a cell are 0 on a \
                tread and far too large at a riser. U is too small where the field is flatter than its \
                noise; a larger step helps.",
        field: Specimen::new(one("half-precision", ball()), Treatment::Half, ring()),
        verdict: Verdict::Limit,
        claims: vec![claim("the ball is pinned", Quantity::Block, 2.2..=3.5)],
    }
}

const FAULTS: [(&str, &str, f32); 3] = [
    (
        "fault-nan",
        "NaN in a spot on the ball: rays that meet it are dropped and counted, all others count as before.",
        f32::NAN,
    ),
    (
        "fault-infinite",
        "Infinite density in a spot on the ball: rays that meet it are dropped and counted.",
        f32::INFINITY,
    ),
    ("fault-negative", "Negative density in a spot on the ball: rays that meet it are dropped and counted.", -5.0),
];

/// A spot on the ball's surface, so small that less than a hundredth of the rays meet it.
fn fault(name: &'static str, about: &'static str, density: f32) -> HardScene {
    let treatment = Treatment::Fault { density, center: Vec3::new(0.3, 0.3, 0.26), radius: 0.13 };
    HardScene {
        name,
        about,
        field: Specimen::new(one(name, ball()), treatment, ring()),
        verdict: Verdict::Handled,
        claims: vec![
            claim("the ball is pinned elsewhere", Quantity::Block, 2.2..=3.5),
            claim("some rays are dropped, less than a hundredth", Quantity::Dropped, 1e-3..=1e-2),
        ],
    }
}

fn denormal() -> HardScene {
    // The smallest normal number is 1.2e-38.
    let treatment = Treatment::Fault { density: 1e-40, center: Vec3::new(0.3, 0.3, 0.26), radius: 0.3 };
    HardScene {
        name: "fault-denormal",
        about: "Denormal densities in a bite out of the ball: as good as none.",
        field: Specimen::new(one("fault-denormal", ball()), treatment, ring()),
        verdict: Verdict::Handled,
        claims: vec![
            claim("what is left of the ball is pinned", Quantity::Block, 2.2..=3.5),
            claim("no ray is dropped", Quantity::Dropped, 0.0..=0.0),
        ],
    }
}

fn fault_everywhere() -> HardScene {
    let treatment = Treatment::Fault { density: f32::NAN, center: Vec3::new(0.3, 0.3, 0.26), radius: 0.5 };
    HardScene {
        name: "fault-everywhere",
        about: "NaN over half of the ball: what is left would be no answer, so that the run ends with an error which \
                names the first position.",
        field: Specimen::new(one("fault-everywhere", ball()), treatment, ring()),
        verdict: Verdict::Refused,
        claims: Vec::new(),
    }
}
