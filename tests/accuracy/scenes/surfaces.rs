//! Scenes that are hard because of what is seen.

use std::f32::consts::PI;

use glam::Vec3;

use super::{CELL, HardScene, Specimen, Treatment, Verdict, claim, one, ring, several, waves};
use super::{Primitive, Quantity, Shape, Texture};

const PLAIN: Texture = Texture::Plain(Vec3::new(0.8, 0.3, 0.2));

/// All scenes of this module.
pub fn all() -> Vec<HardScene> {
    vec![
        wall_axis(),
        wall_diagonal(),
        checker_coarse(),
        checker_fine(),
        opaque_step(),
        thin_sheet(),
        fog(),
        saturated(),
    ]
}

/// A wall through the origin.
pub fn wall(normal: Vec3, texture: Texture) -> Primitive {
    let shape = Shape::Slab { center: Vec3::ZERO, normal: normal.normalize(), half: 0.2 };
    Primitive { shape, peak: 80.0, softness: 0.06, texture }
}

/// One untreated shape in the usual box, seen by twelve cameras around it.
pub fn specimen(primitive: Primitive) -> Specimen {
    Specimen::new(one("one shape", primitive), Treatment::Exact, ring())
}

/// Checks with this edge in scene units and soft rims: their sign is that of a product of sines.
pub fn checks(edge: f32) -> Texture {
    waves(PI / edge)
}

fn wall_axis() -> HardScene {
    HardScene {
        name: "wall-axis",
        about: "A textureless wall that faces an axis: nothing tells how far it slides along itself, so that two of \
                three priors stay, in every reading.",
        field: Specimen::new(one("wall-axis", wall(Vec3::X, PLAIN)), Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        // ½ log10(3/2) = 0.08805 if one of three equal variances vanishes.
        claims: vec![
            claim("one of three directions is pinned: 0.088", Quantity::Diagonal, 0.087..=0.08806),
            claim("one of three directions is pinned: 0.088", Quantity::Block, 0.087..=0.08806),
        ],
    }
}

fn wall_diagonal() -> HardScene {
    HardScene {
        name: "wall-diagonal",
        about: "The same wall, facing (1, 1, 1): `block` says what it said before, but `diagonal` (the paper's) now \
                takes the wall for pinned in all directions, decades below.",
        field: Specimen::new(one("wall-diagonal", wall(Vec3::ONE, PLAIN)), Treatment::Exact, ring()),
        verdict: Verdict::Limit,
        claims: vec![
            claim("`diagonal` sees three pinned directions", Quantity::Diagonal, 3.1..=4.2),
            // Differences in f32 are wrong by 1e-3 across the normal. That passes for 1e-6 of
            // the information along it.
            claim("`block` sees one: 0.088, and some rounding", Quantity::Block, 0.087..=0.5),
        ],
    }
}

fn checker_coarse() -> HardScene {
    let field = one("checker-coarse", wall(Vec3::X, checks(4.0 * CELL)));
    HardScene {
        name: "checker-coarse",
        about: "A wall of checks four cells wide: texture pins all three directions.",
        field: Specimen::new(field, Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("all directions are pinned by decades", Quantity::Block, 2.5..=3.6)],
    }
}

fn checker_fine() -> HardScene {
    let field = one("checker-fine", wall(Vec3::X, checks(0.25 * CELL)));
    HardScene {
        name: "checker-fine",
        about: "A wall of checks a quarter of a cell wide: U is small, as a small shift is noticed at once; \
                that a shift by two checks looks the same again is beyond a Laplace approximation. A vertex \
                moves many checks together.",
        field: Specimen::new(field, Treatment::Exact, ring()),
        verdict: Verdict::Limit,
        claims: vec![claim("all directions are pinned by decades", Quantity::Block, 3.5..=4.6)],
    }
}

fn opaque_step() -> HardScene {
    let solid = |shape| Primitive { shape, peak: 1e4, softness: 1e-3 * CELL, texture: PLAIN };
    let round = Shape::Ball { center: Vec3::new(0.0, 0.45, 0.1), radius: 0.4 };
    let square = Shape::Box { center: Vec3::new(0.1, -0.45, -0.1), half: Vec3::new(0.3, 0.25, 0.4) };
    HardScene {
        name: "opaque-step",
        about: "Density from 0 to 10,000 within a five hundredth of a cell: its derivative is a spike that few samples \
                meet. Where one does, U is far too small, elsewhere it is the prior; how many do depends on the step \
                of the finite differences, which blurs the spike. It is chance.",
        field: Specimen::new(several("opaque-step", vec![solid(round), solid(square)]), Treatment::Exact, ring()),
        verdict: Verdict::Limit,
        claims: vec![claim(
            "where the spike is met, which is chance, a surface looks pinned",
            Quantity::Block,
            0.05..=8.0,
        )],
    }
}

fn thin_sheet() -> HardScene {
    let shape = Shape::Slab { center: 0.5 * CELL * Vec3::X, normal: Vec3::X, half: CELL / 16.0 };
    let sheet = Primitive { shape, peak: 200.0, softness: CELL / 32.0, texture: waves(9.0) };
    let mut field = one("thin-sheet", sheet);
    field = field.with_step(f64::from(CELL) / 32.0);
    HardScene {
        name: "thin-sheet",
        about: "A sheet an eighth of a cell thick between two lattice planes: its two sides pull at the same \
                vertices and nearly cancel within a ray, which is why Jacobians are summed over the ray \
                before they are squared.",
        field: Specimen::new(field, Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        claims: vec![
            claim("the sheet is found", Quantity::Block, 2.3..=3.3),
            // Two of 33 lattice planes, most of which the cameras see.
            claim("at the two lattice planes beside it, nowhere else", Quantity::Lowered, 0.03..=0.0607),
        ],
    }
}

fn fog() -> HardScene {
    let shape = Shape::Fog { center: Vec3::ZERO, radius: 0.9 };
    let fog = Primitive { shape, peak: 0.5, softness: 0.0, texture: Texture::Plain(Vec3::new(0.7, 0.6, 0.8)) };
    HardScene {
        name: "fog",
        about: "Thin fog and nothing else: every part of it can be moved far before a pixel changes, so \
                that U is large everywhere; but images say a little about all of it, and the prior is weak \
                enough to be moved by that.",
        field: Specimen::new(one("fog", fog), Treatment::Exact, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("far less is pinned than at any surface", Quantity::Block, 0.1..=0.6)],
    }
}

fn saturated() -> HardScene {
    let field = one("saturated", wall(Vec3::X, waves(9.0)));
    HardScene {
        name: "saturated",
        about: "A textured wall whose colours lie where the sigmoid is flat: the texture is there in the network and \
                gone in the picture, so that the wall counts as textureless.",
        field: Specimen::new(field, Treatment::Saturated, ring()),
        verdict: Verdict::Handled,
        claims: vec![claim("one of three directions is pinned: 0.088", Quantity::Block, 0.087..=0.08806)],
    }
}
