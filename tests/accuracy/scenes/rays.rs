//! Scenes that are hard because of where rays run. Cameras with one pixel send them there.

use glam::{DVec3, Vec3};

use super::surfaces::wall;
use super::{CELL, HardScene, Quantity, Specimen, Treatment, Verdict, claim, one, single_rays, waves};

/// All scenes of this module.
pub fn all() -> Vec<HardScene> {
    vec![lattice_line(), lattice_vertex(), in_face(), grazing()]
}

/// Lattice cells per half edge of the box.
const HALF: f64 = 16.0;

fn specimen(name: &str, viewpoints: Vec<(DVec3, DVec3)>) -> Specimen {
    Specimen::new(one(name, wall(Vec3::X, waves(9.0))), Treatment::Exact, single_rays(viewpoints))
}

fn lattice_line() -> HardScene {
    // Along x, exactly on lattice lines, where y and z are multiples of a cell.
    let cell = f64::from(CELL);
    let rays = (0..16).map(|i| {
        let (y, z) = (f64::from(2 * (i % 4) - 3) * cell, f64::from(2 * (i / 4) - 3) * cell);
        (DVec3::new(2.5, y, z), DVec3::new(0.0, y, z))
    });
    HardScene {
        name: "ray-lattice-line",
        about: "Rays exactly on lattice lines: samples lie on cells' edges, where three of four vertices around have \
                weight 0. They are not moved.",
        field: specimen("ray-lattice-line", rays.collect()),
        verdict: Verdict::Handled,
        claims: vec![
            claim("the wall is pinned on the lines", Quantity::Block, 3.1..=4.3),
            // 16 of the 33² lines, at most five vertices deep: the wall's front is 0.12 deep, but
            // vertices beside it count.
            claim("only vertices on the lines move", Quantity::Lowered, 16.0 / 35_937.0..=80.0 / 35_937.0),
        ],
    }
}

fn lattice_vertex() -> HardScene {
    // Along space diagonals through lattice points: rounding decides in which of eight cells a sample falls.
    let cell = f64::from(CELL);
    let rays = (0..16).map(|i| {
        let vertex = DVec3::new(4.0, f64::from(i % 4) - 2.0, f64::from(i / 4) - 1.0) * cell;
        let sign = |bit: i32| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
        (vertex + 1.5 * DVec3::new(1.0, sign(0), sign(1)), vertex)
    });
    HardScene {
        name: "ray-lattice-vertex",
        about: "Rays along space diagonals through lattice vertices: rounding decides in which cell a sample falls, \
                and must not matter.",
        field: specimen("ray-lattice-vertex", rays.collect()),
        verdict: Verdict::Handled,
        claims: vec![claim("the wall is pinned along the rays", Quantity::Block, 3.1..=4.3)],
    }
}

fn in_face() -> HardScene {
    // In the two faces of the box across y, straight and oblique, and in lattice planes inside.
    let cell = f64::from(CELL);
    let rays = (0..16).map(|i| {
        let y = [1.0, -1.0, 3.0 * cell, -8.0 * cell][i as usize % 4];
        let z = 0.1 * f64::from(i / 4) - 0.13;
        (DVec3::new(2.5, y, z), DVec3::new(0.0, y, -z))
    });
    HardScene {
        name: "ray-in-face",
        about: "Rays that run in the box's faces and in lattice planes: faces belong to the box, and derivatives there \
                look inwards only.",
        field: specimen("ray-in-face", rays.collect()),
        verdict: Verdict::Handled,
        claims: vec![claim("the wall is pinned where rays pass", Quantity::Block, 3.1..=4.3)],
    }
}

fn grazing() -> HardScene {
    let corner = DVec3::ONE;
    let across = DVec3::new(1.0, -1.0, 0.0);
    let beside = 1.0 + 1e-9;
    let cell = 1.0 / HALF;
    let rays = vec![
        // Along an edge of the box, in two faces at once.
        (DVec3::new(2.5, 1.0, 1.0), DVec3::new(0.0, 1.0, 1.0)),
        (DVec3::new(2.5, -1.0, 1.0), DVec3::new(0.0, -1.0, 1.0)),
        // A hair outside a face.
        (DVec3::new(2.5, beside, 0.0), DVec3::new(0.0, beside, 0.0)),
        // Touches an upright edge, and a corner, in one point.
        (corner - 0.5 * DVec3::Z + 2.0 * across, corner - 0.5 * DVec3::Z),
        (corner + 2.0 * across, corner),
        // Cuts an upright edge within a thousandth of a cell.
        (corner - 0.5 * DVec3::Z - 1e-3 * cell * corner + 2.0 * across, corner - 0.5 * DVec3::Z - 1e-3 * cell * corner),
        // Past everything.
        (DVec3::new(2.5, 3.0, 0.0), DVec3::new(0.0, 3.0, 0.0)),
    ];
    HardScene {
        name: "ray-grazing",
        about: "Rays along the box's edges, past them by a billionth, and through its corners: those along an edge \
                count, the others see nothing.",
        field: specimen("ray-grazing", rays),
        verdict: Verdict::Handled,
        claims: vec![
            claim("the wall is pinned on two edges of the box", Quantity::Block, 3.1..=4.3),
            claim("only vertices on these edges move", Quantity::Lowered, 2.0 / 35_937.0..=10.0 / 35_937.0),
        ],
    }
}
