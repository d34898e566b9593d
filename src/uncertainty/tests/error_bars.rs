//! Error bars of whole fields, against fields without each group, and between vertices.

use super::*;
use crate::uncertainty::layers::error_bars::{Jackknife, Replicates};

/// Rays of every group that saw a vertex. With one ray in each of three groups, every 25th vertex has too few.
fn rays_of_a_group(v: usize, sums: &VertexSums) -> u32 {
    if v % 25 == 1 { sums.rays.min(1) } else { 2 * sums.rays }
}

/// The field with error bars from three groups that saw each vertex unequally. Every fifth vertex was seen by
/// only one group.
pub(super) fn with_bars(field: UncertaintyField) -> UncertaintyField {
    let share = |v: usize, g: usize| match v % 5 {
        0 => [1.0, 0.0, 0.0][g],
        n => [0.5, 0.3 - 0.05 * n as f64, 0.2 + 0.05 * n as f64][g],
    };
    let sums = field.sums().unwrap().to_vec();
    let group = |g: usize| {
        let part = |(v, e): (usize, &VertexSums)| {
            let share = share(v, g);
            VertexSums::new(e.information.map(|s| share * s), u32::from(share > 0.0) * rays_of_a_group(v, e))
        };
        sums.iter().enumerate().map(part).collect()
    };
    barred(field, [0, 1, 2].map(group), &[8, 7, 5])
}

#[test]
fn error_bars_are_those_of_fields_without_each_group() {
    for covariance in Covariance::ALL {
        let of = |pooling| pooled_fields(covariance, 1.0, pooling);
        for field in [Pooling::Off, Pooling::Auto].into_iter().flat_map(of) {
            let field = with_bars(field);
            let sums = field.sums().unwrap();
            let bars = field.error_bars().unwrap();
            assert_eq!((bars.groups(), bars.len()), (3, sums.len()));
            // By hand: the fields of the other groups' rays, computed as fields are.
            let field_of = |record, sums| UncertaintyField::new(record, field.lattice, field.support.clone(), sums);
            let without = |g: usize, pooling: Pooling| {
                let kept = |v: usize| match v % 5 {
                    0 => [0.0, 1.0, 1.0][g],
                    n => 1.0 - [0.5, 0.3 - 0.05 * n as f64, 0.2 + 0.05 * n as f64][g],
                };
                // Each of the other groups that saw a vertex counts its rays.
                let rays = |v: usize| if v.is_multiple_of(5) { u32::from(g != 0) } else { 2 };
                let part = |(v, e): (usize, &VertexSums)| {
                    VertexSums::new(e.information.map(|s| kept(v) * s), rays(v) * rays_of_a_group(v, e))
                };
                let record = RunRecord { rays: [12, 13, 15][g], pooling, ..field.record.clone() };
                field_of(record, sums.iter().enumerate().map(part).collect())
            };
            let pooling = field.record.pooling;
            let others = [0, 1, 2].map(|g| without(g, pooling));
            let own = field_of(RunRecord { pooling: Pooling::Off, ..field.record.clone() }, sums.to_vec());
            let own_others = [0, 1, 2].map(|g| without(g, Pooling::Off));
            let mut known = 0;
            for (v, e) in sums.iter().enumerate() {
                let at = |of: &UncertaintyField| of.deviations().get(v).log10();
                let jackknife = |value, deleted: [f64; 3]| {
                    Jackknife::new(&Replicates { value, deleted: deleted.to_vec() }, &[8, 7, 5])
                };
                let [theta, tau] = [&field, &own].map(at);
                let [thetas, taus] = [&others, &own_others].map(|all| all.each_ref().map(at));
                let found = jackknife(theta, thetas);
                let expected = if pooling == Pooling::Off {
                    found.error()
                } else {
                    let limit = tau - jackknife(tau, taus).bias;
                    let noise = jackknife(theta - tau, [0, 1, 2].map(|g| thetas[g] - taus[g])).standard_error;
                    let bias = ((theta - limit).powi(2) - noise.powi(2)).max(0.0).sqrt();
                    found.standard_error.hypot(bias)
                };
                if e.rays == 0 || v.is_multiple_of(5) || v % 25 == 1 {
                    assert_eq!(bars.get(v), None, "one group, three rays or none saw vertex {v}");
                } else {
                    // Bits of f16, sums of rounded parts, and σ in f32.
                    let found = bars.get(v).unwrap();
                    assert!(
                        (found - expected).abs() <= 1e-3 * expected + 1e-6,
                        "{covariance:?} {v}: {found}, {expected}"
                    );
                    known += 1;
                }
            }
            assert!(known > 50, "{known}");
        }
    }
}

#[test]
fn errors_between_vertices_are_means_by_shares_of_u() {
    for covariance in [Covariance::Diagonal, Covariance::Trace] {
        let [dense, octree] = fields(covariance, 1.0).map(with_bars);
        let n = 33_usize;
        let mut known = 0;
        for (i, x) in samples(1.0).positions.into_iter().enumerate() {
            let (cell, offset) = dense.lattice().cell(dense.lattice().coordinates(x).unwrap());
            let (mut sum, mut total) = (Some(0.0), 0.0);
            for (c, weight) in trilinear(offset).into_iter().enumerate().filter(|(_, weight)| *weight > 0.0) {
                let [x, y, z] = [0, 1, 2].map(|axis| cell[axis] as usize + (c >> axis & 1));
                let v = (x * n + y) * n + z;
                let share = weight * dense.deviations().get(v);
                let share = if covariance == Covariance::Trace { share * share } else { share };
                sum = sum.zip(dense.error_bars().unwrap().get(v)).map(|(sum, e)| sum + share * e);
                total += share;
            }
            let found = dense.query(x).log10_error;
            assert_eq!(found.is_some(), sum.is_some(), "one corner that is not known makes the point unknown, {i}");
            if let (Some(found), Some(sum)) = (found, sum) {
                assert!((found - sum / total).abs() < 1e-12, "{found}");
                known += 1;
            }
            assert_eq!(octree.query(x).log10_error, octree.query_all(&[x])[0].log10_error);
        }
        assert!(known > 0 && known < 40, "{known}");
        // At a vertex, queries return its own error. Nothing is known outside the box or without error bars.
        let v = (0..n * n * n).find(|&v| dense.error_bars().unwrap().get(v).is_some_and(|e| e > 0.0)).unwrap();
        let at = DVec3::from([v / (n * n), v / n % n, v % n].map(|i| i as f64));
        let found = dense.query(dense.lattice().position(at).as_vec3()).log10_error.unwrap();
        assert!((found - dense.error_bars().unwrap().get(v).unwrap()).abs() < 1e-12);
        assert_eq!(dense.query(Vec3::splat(2.0)).log10_error, None);
        assert_eq!(fields(covariance, 1.0)[0].query(Vec3::ZERO).log10_error, None);
    }
}
