//! A mesh that needs no data.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use glam::DVec3;

/// A trefoil's tube as OBJ text.
#[must_use]
pub fn knot() -> String {
    const ALONG: usize = 160;
    const AROUND: usize = 20;
    let center =
        |t: f64| DVec3::new(t.sin() + 2.0 * (2.0 * t).sin(), t.cos() - 2.0 * (2.0 * t).cos(), -(3.0 * t).sin());
    let mut obj = String::new();
    for i in 0..ALONG {
        let t = TAU * i as f64 / ALONG as f64;
        let tangent = (center(t + 1e-4) - center(t - 1e-4)).normalize();
        let side = tangent.cross(DVec3::Z).normalize();
        let up = side.cross(tangent);
        for k in 0..AROUND {
            let angle = TAU * k as f64 / AROUND as f64;
            let v = center(t) + 0.55 * (angle.cos() * side + angle.sin() * up);
            writeln!(obj, "v {} {} {}", v.x, v.y, v.z).expect("writing to a string");
        }
    }
    let vertex = |i: usize, k: usize| 1 + i % ALONG * AROUND + k % AROUND;
    for i in 0..ALONG {
        for k in 0..AROUND {
            let [a, b, c, d] = [vertex(i, k), vertex(i + 1, k), vertex(i + 1, k + 1), vertex(i, k + 1)];
            writeln!(obj, "f {a} {b} {c}\nf {a} {c} {d}").expect("writing to a string");
        }
    }
    obj
}
