//! Intersection of rays and triangles without gaps: Woop, Benthin, Wald, *Watertight Ray/Triangle
//! Intersection*, JCGT 2013.
//!
//! Letters: `x y z` are coordinates after a shear that puts the ray's origin at 0 and its direction on the third
//! axis. `u v w` are edge functions: twice the signed areas between the origin and the triangle's edges in the
//! sheared xy plane. They are also the unnormalised barycentric weights of corners 0, 1 and 2.

use glam::DVec3;

use octobayes::geometry::Ray;

/// The point where a ray meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Distance along the ray in scene units, ≥ 0.
    pub t: f64,
    /// Weights of the three corners, ≥ 0, sum 1.
    pub barycentric: [f64; 3],
}

/// A ray prepared for many triangles.
#[derive(Debug, Clone, Copy)]
pub struct ShearedRay {
    origin: DVec3,
    /// Axes that take the parts of x, y and z. The direction is longest along z.
    axes: [usize; 3],
    /// direction.x / direction.z, direction.y / direction.z and 1 / direction.z, in the new order.
    shear: [f64; 3],
}

impl ShearedRay {
    /// Prepares a ray.
    #[must_use]
    pub fn new(ray: &Ray) -> Self {
        let z = ray.direction.abs().max_position();
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let d = axes.map(|k| ray.direction[k]);
        Self { origin: ray.origin, axes, shear: [d[0] / d[2], d[1] / d[2], 1.0 / d[2]] }
    }

    /// The crossing with a triangle, from either side. `None` if the triangle is missed, behind the origin,
    /// or seen exactly edge-on.
    ///
    /// Triangles that share vertices leave no gaps. Sheared corners depend on the vertex alone, and the computed
    /// sign of a·b − c·d is never the wrong one: rounding is monotone, so fl(ab) > fl(cd) only if ab > cd. At worst
    /// it is 0, which counts as inside. Triangles without area have u = v = w = 0 and cover nothing that their
    /// neighbours do not.
    ///
    /// Where a triangle of apparent width w is seen, t is wrong by up to about 1e-14/w of its extent. It never
    /// leaves the range of the corners on the ray's longest axis, because the weights are ≥ 0 and sum to 1.
    #[must_use]
    pub fn cross(&self, corners: &[DVec3; 3]) -> Option<Crossing> {
        let [x, y, z] = self.axes;
        let sheared = corners.map(|corner| {
            let p = corner - self.origin;
            [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], p[z]]
        });
        let [a, b, c] = sheared;
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let total = u + v + w;
        if total == 0.0 {
            return None;
        }
        let barycentric = [u / total, v / total, w / total];
        let t = self.shear[2] * (barycentric[0] * a[2] + barycentric[1] * b[2] + barycentric[2] * c[2]);
        (t >= 0.0).then_some(Crossing { t, barycentric })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(reach: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-reach..reach).prop_map(DVec3::from)
    }

    #[test]
    fn a_known_crossing_from_both_sides() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (height, along) in [(3.0, -DVec3::Z), (-3.0, DVec3::Z)] {
            let ray = Ray::new(DVec3::new(0.25, 0.5, height), along);
            let crossing = ShearedRay::new(&ray).cross(&corners).unwrap();
            assert_eq!((crossing.t, crossing.barycentric), (3.0, [0.25, 0.25, 0.5]));
        }
        let away = Ray::new(DVec3::new(0.25, 0.5, 3.0), DVec3::Z);
        assert!(ShearedRay::new(&away).cross(&corners).is_none(), "behind");
        let edge_on = Ray::new(DVec3::new(-1.0, 0.2, 0.0), DVec3::X);
        assert!(ShearedRay::new(&edge_on).cross(&corners).is_none(), "edge-on");
    }

    proptest! {
        /// Rays aimed at the edges and the hub of a fan hit some triangle of it: there are no gaps,
        /// not even with slivers.
        #[test]
        fn no_gap_at_edges_and_vertices(
            origin in point(4.0),
            turn in point(1.0),
            hub in point(0.3),
            stretch in prop::sample::select(vec![1.0, 1e-3, 1e-9]),
            spoke in 0_usize..7,
            along in prop::sample::select(vec![0.0, 1e-17, 0.3, 0.9]),
        ) {
            let axis = (turn + DVec3::splat(1e-3)).normalize();
            let view = (hub - origin).try_normalize();
            // Seen nearly edge-on, the closed rim itself may be missed. That is not a gap.
            prop_assume!(view.is_some_and(|d| d.dot(axis).abs() > 0.05));
            let right = axis.any_orthonormal_vector();
            let rim: Vec<DVec3> = (0..7)
                .map(|i| {
                    let angle = f64::from(i) * std::f64::consts::TAU / 7.0;
                    hub + stretch * angle.cos() * right + angle.sin() * axis.cross(right)
                })
                .collect();
            let target = hub.lerp(rim[spoke], along);
            // A degenerate triangle bridges each spoke at its middle.
            let mut fan: Vec<[DVec3; 3]> = (0..7).map(|i| [hub, rim[i], rim[(i + 1) % 7]]).collect();
            fan.extend(rim.iter().map(|&r| [hub, hub.midpoint(r), r]));
            let ray = Ray::new(origin, target - origin);
            let sheared = ShearedRay::new(&ray);
            prop_assert!(fan.iter().any(|t| sheared.cross(t).is_some()), "missed {target} from {origin}");
            let distance = (target - origin).length();
            for (i, corners) in fan.iter().enumerate() {
                let Some(hit) = sheared.cross(corners) else { continue };
                prop_assert!((hit.barycentric.iter().sum::<f64>() - 1.0).abs() < 4e-15);
                let axis = ray.direction.abs().max_position();
                let along = corners.map(|c| (c - origin)[axis] / ray.direction[axis]);
                let low = along.into_iter().fold(f64::INFINITY, f64::min);
                let high = along.into_iter().fold(f64::NEG_INFINITY, f64::max);
                // Seen at 0.05 or more, at most 6 units away: rounding moves corners by 2e-15, apparent
                // widths are above 0.05 · 0.4 · stretch. Bridges (from 7) have no width, but their t stays
                // between their corners.
                let off = if i < 7 { 2e-13 / stretch } else { high - low };
                prop_assert!((hit.t - distance).abs() <= off + 1e-13, "{} instead of {distance}, face {i}", hit.t);
                prop_assert!((low - 1e-13..=high + 1e-13).contains(&hit.t), "{} outside {low} to {high}", hit.t);
            }
        }
    }
}
