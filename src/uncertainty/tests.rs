//! Queries, files and the official format, on small fields with arbitrary sums.

use glam::{DVec3, Vec3};

use super::*;
use crate::geometry::Aabb;
use crate::octree::trilinear;
use crate::posterior::{
    Covariance, Criteria, DataScale, DensePosterior, OctreePosterior, Pooling, Posterior, Refinement, Scale, trace,
};
use crate::rays::Pixels;
use crate::render::{RaySample, RaySamples};
use proptest::prelude::*;

mod error_bars;
mod forged;
mod hanging;

pub(super) fn record(lattice: &Lattice, covariance: Covariance, rays: u64) -> RunRecord {
    RunRecord {
        version: "test".into(),
        source: "test".into(),
        model_checksum: None,
        cameras_checksum: None,
        rays,
        dropped: 0,
        pixels: Some(Pixels::Sobol),
        seed: Some(1),
        shard: None,
        lambda: lattice.default_lambda(),
        scale: Scale::Paper,
        covariance,
        pooling: Pooling::Off,
        criteria: Criteria::default(),
        tolerance: 0.01,
        march_step: Some(0.1),
        gradient: None,
        difference_step: None,
        cutoff: Some(1e-4),
        background: Some([1.0; 3]),
        pixel_offset: Some(0.5),
        pixel_angle: None,
    }
}

/// A few rays through a box of edge 2 · scale. Jacobians shrink as lengths grow.
pub(super) fn samples(scale: f32) -> RaySamples {
    let mut out = RaySamples::default();
    for i in 0..40_u64 {
        let t = i as f32 / 40.0;
        let x = Vec3::new(0.9 * (7.0 * t).sin(), 0.5 * (11.0 * t).cos(), 0.3 - 0.2 * t);
        let jacobian = std::array::from_fn(|k| ((k as f32 + 1.0) * (3.0 * t + 1.0)).sin() / scale);
        let sample = RaySample { position: x * scale, jacobian, weight: 0.3 };
        out.push(i / 3, sample);
    }
    out
}

fn fields(covariance: Covariance, scale: f64) -> [UncertaintyField; 2] {
    pooled_fields(covariance, scale, Pooling::Off)
}

/// As in a run: a part is refined wherever a ray passed.
pub(super) fn refinement(record: &RunRecord) -> Refinement {
    let reading = record.reading();
    let floor = if record.is_part() { Refinement::EVERYTHING } else { reading.floor() };
    Refinement::above(floor, &reading, record.criteria, Vec::new())
}

/// The field of sums on the octree that is refined for them.
pub(super) fn on_own_octree(record: RunRecord, lattice: Lattice, posterior: OctreePosterior) -> UncertaintyField {
    let octree = posterior.octree(&refinement(&record)).unwrap();
    UncertaintyField::on_octree(record, lattice, posterior, octree, true).unwrap()
}

/// The field with error bars by groups of rays with these sums at its vertices.
pub(super) fn barred<const N: usize>(
    field: UncertaintyField,
    groups: [Vec<VertexSums>; N],
    rays: &[u64; N],
) -> UncertaintyField {
    let (lattice, limits, support) = (field.lattice, field.limits(), field.support.clone());
    let on_octree = |octree: &Octree, sums: Vec<VertexSums>| {
        let mut posterior = OctreePosterior::limited(lattice, limits.clone());
        octree.vertex_positions().zip(&sums).for_each(|(point, own)| posterior.add_sums(point, own));
        posterior
    };
    let on_grid = |sums| DensePosterior::restore(lattice, &limits, &[], sums).unwrap();
    let barred = match &support {
        Support::Octree(octree) => field.with_error_bars(&groups.map(|sums| on_octree(octree, sums)), rays),
        Support::Dense => field.with_error_bars(&groups.map(on_grid), rays),
    };
    barred.unwrap()
}

fn pooled_fields(covariance: Covariance, scale: f64, pooling: Pooling) -> [UncertaintyField; 2] {
    let lattice = Lattice::new(Aabb::centered_cube(scale), 5).unwrap();
    let samples = [samples(scale as f32)];
    let record = RunRecord { pooling, ..record(&lattice, covariance, 20) };
    let mut dense = DensePosterior::new(lattice);
    dense.add(&samples);
    let mut sparse = OctreePosterior::new(lattice);
    sparse.add(&samples);
    let surface = vec![[0.25, -0.5, 0.125]];
    [
        UncertaintyField::new(record.clone(), lattice, Support::Dense, dense.into_sums()),
        on_own_octree(record, lattice, sparse).with_surface(surface),
    ]
}

proptest! {
    #[test]
    fn octree_and_dense_agree_within_the_tolerance_everywhere(
        x in -1.0..=1.0_f32,
        y in -1.0..=1.0_f32,
        z in -1.0..=1.0_f32,
    ) {
        // Plain ones, and one that is pooled.
        static FIELDS: std::sync::LazyLock<Vec<[UncertaintyField; 2]>> = std::sync::LazyLock::new(|| {
            let block = |pooling| pooled_fields(Covariance::Block, 1.0, pooling);
            let plain = [fields(Covariance::Diagonal, 1.0), block(Pooling::Off)];
            let made: Vec<_> = plain.into_iter().chain([block(Pooling::Auto)]).collect();
            assert!(made.iter().all(|[_, octree]| octree.validate().is_ok()));
            assert!(made[2][0].deviations() != made[1][0].deviations(), "pooled");
            made
        });
        for [dense, octree] in &*FIELDS {
            let difference = (dense.log10(Vec3::new(x, y, z)) - octree.log10(Vec3::new(x, y, z))).abs();
            // The stated tolerance, plus the rounding of σ to f32.
            prop_assert!(difference <= 0.01 + 1e-6, "{}", difference);
        }
    }
}

#[test]
fn scaling_the_scene_scales_the_uncertainty() {
    for covariance in Covariance::ALL {
        // Powers of two scale floats exactly, so fields differ only by roundings in σ: a few ulps of f32.
        let [[_, small], [_, large]] = [1.0, 1024.0].map(|scale| fields(covariance, scale));
        assert_eq!(small.support(), large.support());
        for (s, l) in small.deviations().iter().zip(large.deviations().iter()) {
            assert!((l / s / 1024.0 - 1.0).abs() < 1e-6, "{covariance:?}: {s} and {l}");
        }
    }
}

#[test]
fn outside_the_box_is_the_prior() {
    let [dense, octree] = fields(Covariance::Diagonal, 1.0);
    for field in [dense, octree] {
        for x in [Vec3::splat(1.5), Vec3::new(0.0, -1.001, 0.0), Vec3::splat(f32::NAN), Vec3::splat(f32::INFINITY)] {
            let estimate = field.query(x);
            assert!(!estimate.inside && estimate.level == 0 && estimate.uncertainty == field.prior());
        }
        assert!(field.query(Vec3::ONE).inside, "the upper face belongs to the box");
    }
}

/// A whole run's sums are kept as f32 factors, which answer for every covariance.
#[test]
fn kept_sums_answer_for_every_covariance() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.oct");
    for field in fields(Covariance::Block, 1.0) {
        field.write(&path).unwrap();
        let read = UncertaintyField::read(&path).unwrap();
        assert_eq!((read.deviations(), read.rays()), (field.deviations(), field.rays()));
        for covariance in Covariance::ALL {
            let [kept, exact] = [&read, &field].map(|field| field.clone().with_covariance(covariance).unwrap());
            for (kept, exact) in kept.deviations().iter().zip(exact.deviations().iter()) {
                assert!((kept / exact).log10().abs() < 1e-6, "{covariance:?}: {kept} for {exact}");
            }
        }
    }
}

#[test]
fn sums_allow_another_covariance_later() {
    let [_, diagonal] = fields(Covariance::Diagonal, 1.0);
    let [_, block] = fields(Covariance::Block, 1.0);
    assert_eq!(diagonal.clone().with_covariance(Covariance::Block).unwrap().deviations(), block.deviations());
    let error = diagonal.without_sums().with_covariance(Covariance::Block).unwrap_err();
    assert!(error.to_string().contains("keeps its sums"), "{error}");
}

#[test]
fn comparing_fields_of_different_boxes_is_refused() {
    let [a, _] = fields(Covariance::Trace, 1.0);
    let [b, _] = fields(Covariance::Trace, 2.0);
    assert!(compare(&a, &b, 10, 0).is_err());
    let same = compare(&a, &a, 1000, 0).unwrap().in_box.unwrap();
    assert_eq!((same.max, same.mean), (0.0, 0.0));
}

#[test]
fn batches_answer_as_single_queries_do() {
    // More points than the tiles of two threads hold, unordered: some on faces of cells and of the box, some
    // outside, some NaN.
    let golden = [0.819_172_5_f32, 0.671_043_6, 0.549_700_5];
    let mut points: Vec<Vec3> =
        (0..600_000).map(|i| Vec3::from_array(golden.map(|g| 2.2 * (i as f32 * g).fract() - 1.1))).collect();
    points.iter_mut().step_by(5).for_each(|x| *x = (*x * 16.0).round() / 16.0);
    points[77] = Vec3::new(f32::NAN, 0.0, 0.0);
    points[78] = Vec3::ONE;
    for field in fields(Covariance::Block, 1.0) {
        for field in [field.clone(), field.clone().without_sums(), error_bars::with_bars(field)] {
            let together = field.query_all(&points);
            assert!(points.iter().zip(&together).all(|(&x, found)| *found == field.query(x)));
            assert!(together.iter().filter(|e| !e.inside).count() > 1000);
        }
    }
}

#[test]
fn a_dense_copy_has_the_values_of_every_vertex() {
    let [dense, octree] = fields(Covariance::Block, 1.0);
    let copy = octree.on_dense_grid();
    assert_eq!((copy.support(), copy.deviations().len() as u64), (&Support::Dense, octree.lattice().dense_vertices()));
    for i in 0..33_u32.pow(3) {
        let u = DVec3::new(f64::from(i / 1089), f64::from(i / 33 % 33), f64::from(i % 33));
        let x = octree.lattice().position(u).as_vec3();
        // Binary fractions of the box, so f32 holds every vertex.
        assert_eq!(copy.query(x).uncertainty as f32, octree.query(x).uncertainty as f32, "{x}");
    }
    assert_eq!(dense.on_dense_grid().deviations(), dense.deviations());
}

#[test]
fn another_lambda_is_read_off_the_same_sums() {
    for covariance in Covariance::ALL {
        for field in fields(covariance, 1.0) {
            let lambda = field.record().lambda;
            let larger = field.clone().with_lambda(100.0 * lambda).unwrap();
            // Where nothing was seen, σ falls with √λ. It grows nowhere.
            assert!((larger.prior() * 10.0 / field.prior() - 1.0).abs() < 1e-9);
            let ratios: Vec<f64> =
                larger.deviations().iter().zip(field.deviations().iter()).map(|(l, f)| l / f).collect();
            assert!(ratios.iter().all(|r| *r <= 1.0 + 1e-6) && ratios.iter().any(|r| *r < 0.5));
            // The way back is exact on a grid. It is refused on an octree, which did not keep what was negligible.
            match larger.support() {
                Support::Dense => assert_eq!(larger.with_lambda(lambda).unwrap().deviations(), field.deviations()),
                Support::Octree(_) => assert!(larger.with_lambda(lambda).is_err()),
            }
            assert!(field.clone().with_lambda(f64::NAN).is_err());
            assert!(field.without_sums().with_lambda(lambda).is_err());
        }
    }
}

#[test]
fn the_scale_of_the_data_is_a_factor_and_a_prior() {
    // λ = s² / (N τ²) a hundred times the default.
    let data = DataScale::new(1000, 0.02, 2e-3 / (1e5 * fields(Covariance::Block, 1.0)[0].record().lambda).sqrt());
    let data = data.unwrap();
    for covariance in Covariance::ALL {
        for field in fields(covariance, 1.0) {
            let record = RunRecord { scale: Scale::Data(data), lambda: data.lambda(), ..field.record().clone() };
            let sums = field.sums().unwrap().to_vec();
            let scaled = UncertaintyField::new(record, *field.lattice(), field.support().clone(), sums);
            let factor = Scale::Data(data).factor(covariance);
            for (sums, found) in field.sums().unwrap().iter().zip(scaled.deviations().iter()) {
                let expected = factor * covariance.deviation(sums, field.record().rays, data.lambda());
                assert!((found / expected - 1.0).abs() < 1e-6, "{found} for {expected}");
            }
            let axes = if covariance == Covariance::Trace { 1.0 } else { 3.0_f64 };
            assert!((scaled.prior() / (axes.sqrt() * data.prior_deviation) - 1.0).abs() < 1e-9);
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("scaled.oct");
            scaled.write(&path).unwrap();
            assert_eq!(UncertaintyField::read(&path).unwrap().record(), scaled.record());
            assert_eq!(scaled.with_lambda(data.lambda()).unwrap().record().scale, Scale::Paper);
        }
    }
}

#[test]
fn surfaces_are_compared_at_the_reference_s_points() {
    let [dense, octree] = fields(Covariance::Diagonal, 1.0);
    let many = octree.clone().with_surface(vec![[0.1; 3]; 5]);
    let few = dense.with_surface(vec![[0.2; 3]; 2]);
    let points =
        |a: &UncertaintyField, b: &UncertaintyField| compare(a, b, 10, 0).unwrap().on_surfaces.map(|d| d.points);
    assert_eq!(points(&many, &few), Some(2));
    assert_eq!(points(&few, &many), Some(5));
    // If the reference has no points, those of the field are used.
    assert_eq!(points(&few, &octree.with_surface(Vec::new())), Some(2));
}

/// Settings and sections that are not known are passed over, and optional settings may be missing.
#[test]
fn headers_may_grow() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.oct");
    let field = fields(Covariance::Block, 1.0)[0].clone().without_sums();
    field.write(&path).unwrap();
    forged::forge(&path, |header, sections| {
        header["content"]["record"]["lens"] = "wide".into();
        header["content"]["record"].as_object_mut().unwrap().remove("difference_step").unwrap();
        let new = serde_json::json!({"name": "ray_coverage", "bytes": 5, "crc32": 0});
        header["sections"].as_array_mut().unwrap().insert(1, new);
        sections.insert(1, b"12345".to_vec());
    });
    assert_eq!(UncertaintyField::read(&path).unwrap(), field);
}

#[test]
fn matrices_have_the_trace_of_the_squared_uncertainty() {
    let points: Vec<Vec3> = (0..200)
        .map(|i| {
            let t = i as f32 / 200.0;
            Vec3::new(1.1 * (5.0 * t).sin(), 1.1 * (7.0 * t).cos(), 1.1 * (13.0 * t).sin())
        })
        .chain(samples(1.0).positions)
        .collect();
    for covariance in Covariance::ALL {
        for pooling in [Pooling::Off, Pooling::Auto] {
            let [dense, octree] = pooled_fields(Covariance::Diagonal, 1.0, pooling);
            let [found, on_octree] = [&dense, &octree].map(|field| field.covariances(&points, covariance).unwrap());
            let read = dense.clone().with_covariance(covariance).unwrap();
            let is_slanted: fn(&[f64; 6]) -> bool = |m| m[1].abs() > 1e-3 * trace(m);
            assert_eq!(found.iter().any(is_slanted), covariance == Covariance::Block);
            for ((&x, m), n) in points.iter().zip(&found).zip(&on_octree) {
                let variance = read.query(x).uncertainty.powi(2);
                // A few roundings of f64.
                assert!((trace(m) / variance - 1.0).abs() < 1e-13, "{covariance:?} at {x}");
                // The octree keeps all that moved by the tolerance: 0.01 decades of U, twice that of its square.
                let off = (trace(n) / variance).log10().abs();
                assert!(off <= 0.02 + 1e-6, "{covariance:?} at {x}: {off}");
                // A matrix of displacements has no negative variance in any direction.
                let [xx, xy, xz, yy, yz, zz] = *m;
                let determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
                assert!(xx > 0.0 && xx * yy - xy * xy > 0.0 && determinant > 0.0, "{m:?}");
            }
            let error = dense.without_sums().covariances(&points, covariance).unwrap_err();
            assert!(error.to_string().contains("keeps its sums"), "{error}");
        }
    }
}

/// On leaves that are two levels coarser everywhere, the field is that of the coarser lattice. Its information is
/// divided by their volume, 8².
#[test]
fn information_of_coarse_leaves_is_divided_by_their_volume() {
    let levels_up = 2;
    let lattice = Lattice::new(Aabb::centered_cube(1.0), 6).unwrap();
    let coarser = lattice.coarsened(6 - levels_up);
    let limits = MaxLevels::balanced(6, (0..8).map(|region| (region, 6 - levels_up)));
    for covariance in Covariance::ALL {
        let field = |lattice: Lattice, limits: MaxLevels, lambda: f64| {
            let record = RunRecord { tolerance: 0.0, lambda, ..record(&lattice, covariance, 20) };
            let mut posterior = OctreePosterior::limited(lattice, limits);
            posterior.add(&[samples(1.0)]);
            on_own_octree(record, lattice, posterior)
        };
        let (lambda, volume) = (lattice.default_lambda(), 8_f64.powi(levels_up.into()));
        let limited = field(lattice, limits.clone(), lambda);
        // (S / v + λ)⁻¹ = v (S + v λ)⁻¹.
        let unlimited = field(coarser, MaxLevels::none(6 - levels_up), volume * lambda);
        let mut seen = 0;
        for i in 0..5000_u32 {
            let x = 0.95 * Vec3::from([0.9, 1.7, 2.3].map(|k: f32| (k * i as f32).sin()));
            let [found, expected] = [limited.log10(x), unlimited.log10(x) + 0.5 * volume.log10()];
            // Deviations are stored as f32, relative error 6e-8.
            assert!((found - expected).abs() < 1e-6, "{covariance:?} at {x}: {found} instead of {expected}");
            seen += u32::from(found < limited.prior().log10() - 0.1);
        }
        assert!(seen > 100, "{covariance:?}: {seen} of 5000 points know more than the prior");
    }
}
