//! Every change against every layer, and files with any of them.

use proptest::prelude::*;

use super::*;
use crate::geometry::{Aabb, Lattice};
use crate::posterior::{Covariance, DataScale, OctreePosterior, Posterior, Scale};
use crate::rays::Shard;
use crate::uncertainty::tests::{barred, on_own_octree, record, samples};
use crate::uncertainty::{RunRecord, Support, UncertaintyField, merge};

/// A field of a shard's rays with all layers. Limits and a dense grid exclude each other.
fn field(seed: u64, shard: Shard, is_dense: bool) -> UncertaintyField {
    let lattice = Lattice::new(Aabb::centered_cube(1.0), 6).unwrap();
    let data = DataScale::new(1000, 0.02, 0.05).unwrap();
    let (seed, shard) = (Some(seed), Some(shard));
    let plain = record(&lattice, Covariance::Diagonal, 3072);
    let record = RunRecord { scale: Scale::Data(data), lambda: data.lambda(), seed, shard, ..plain };
    let mut posterior = OctreePosterior::limited(lattice, MaxLevels::balanced(6, [(0, 4), (3, 3), (5, 5)]));
    posterior.add(&[samples(1.0)]);
    let mut field = on_own_octree(record, lattice, posterior);
    if is_dense {
        let count = lattice.dense_vertices() as usize;
        let sums = field.sums().unwrap().iter().copied().cycle().take(count).collect();
        field = UncertaintyField::new(field.record.clone(), lattice, Support::Dense, sums);
    }
    let sums = field.sums().unwrap().to_vec();
    let more = sums.iter().map(|own| VertexSums::new(own.information.map(|s| 2.0 * s), 9)).collect();
    let counts = (0..1 << 18).map(|i| i % 13).collect();
    barred(field, [sums, more], &[1000, 2072])
        .with_surface(vec![[0.25, -0.5, 0.125], [0.5; 3]])
        .with_ray_coverage(RayCoverage::from_counts(&lattice, counts))
        .with_conformal(Conformal { probability: 0.9, factor: 1.5, pixels: 100, views: 2 })
}

pub(in crate::uncertainty) fn whole() -> UncertaintyField {
    field(0, Shard::whole(3072), false)
}

#[test]
fn changes_drop_the_layers_that_depend_on_them_and_no_others() {
    type Changed = fn(UncertaintyField) -> UncertaintyField;
    let changes: [(&str, Changed, &[&str]); 11] = [
        ("the same covariance", |f| f.with_covariance(Covariance::Diagonal).unwrap(), &[]),
        ("covariance", |f| f.with_covariance(Covariance::Block).unwrap(), &["error bars", "calibration"]),
        ("lambda", |f| f.with_lambda(1e9).unwrap(), &["error bars", "calibration"]),
        ("sums", UncertaintyField::without_sums, &["sums"]),
        ("what queries need", UncertaintyField::for_queries, &["sums"]),
        ("grid", |f| f.on_dense_grid(), &["sums", "error bars", "calibration"]),
        ("surface", |f| f.with_surface(Vec::new()), &["surface points"]),
        ("ray coverage", |f| f.with_ray_coverage(None), &["ray coverage"]),
        ("ray sets", |f| f.with_ray_sets(Vec::new()), &["ray sets"]),
        ("model", |f| f.with_model(7), &[]),
        (
            "sums and covariance",
            |f| f.with_covariance(Covariance::Block).unwrap().without_sums(),
            &["sums", "error bars", "calibration"],
        ),
    ];
    let before = whole();
    assert_eq!(before.layers.names(), NAMES);
    for (change, apply, dropped) in &changes {
        let mut expected = before.layers.clone();
        dropped.iter().for_each(|name| expected.remove(name));
        assert!(apply(before.clone()).layers == expected, "{change}: {:?}", apply(before.clone()).layers.names());
    }
}

#[test]
fn merging_adds_what_adds_up_and_drops_the_rest() {
    let parts = [0, 1].map(|seed| field(seed, Shard::whole(3072), false));
    let merged = merge(&parts).unwrap();
    let kept = ["ray sets", "sums", "surface points", "ray coverage", "limits"];
    assert_eq!(merged.layers.names(), kept);
    let [ray_sets, surface] = [merged.ray_sets().len(), merged.surface().len()];
    assert_eq!((ray_sets, surface, merged.limits()), (2, 2, parts[0].limits()));
    // What one part lacks: sums and limits are those of all or there is no merge.
    for (name, is_kept) in [("ray sets", false), ("surface points", true), ("ray coverage", false)] {
        for lacking in [0, 1] {
            let mut parts = parts.clone();
            parts[lacking].layers.remove(name);
            // As if other programs had drawn the rays.
            parts.iter_mut().zip(["a", "b"]).for_each(|(part, source)| {
                (part.record.march_step, part.record.source) = (None, source.into());
            });
            let names = merge(&parts).unwrap().layers.names();
            let expected: Vec<&str> = kept.into_iter().filter(|other| *other != name || is_kept).collect();
            assert_eq!(names, expected, "{name} is missing in part {lacking}");
        }
    }
}

/// The table of `docs/src/formats.md`.
#[test]
fn the_book_lists_all_layers_and_what_they_depend_on() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/src/formats.md");
    let page = std::fs::read_to_string(page).unwrap();
    for (name, changes, is_merged) in Layers::table() {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("a row of `{name}`"));
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let expected: Vec<String> = changes.iter().map(|change| format!("{change:?}").to_lowercase()).collect();
        assert_eq!(cells[4], expected.join(", "), "{name}");
        // A merge adds sums itself.
        assert_eq!(cells[5] == "dropped", !is_merged && name != Vec::<VertexSums>::NAME, "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn files_keep_any_layers(
        kept in any::<[bool; NAMES.len()]>(),
        is_part: bool,
        is_dense: bool,
        checksum: Option<u32>,
    ) {
        let shard = Shard::new(3072, 0, if is_part { 2 } else { 1 });
        let mut field = field(3, shard, is_dense);
        field.record.model_checksum = checksum;
        NAMES.iter().zip(kept).filter(|(_, kept)| !kept).for_each(|(name, _)| field.layers.remove(name));
        // Only parts keep exact counts; these are small enough to be exact in any case.
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["a.oct", "b.oct"].map(|name| folder.path().join(name));
        field.write(&first).unwrap();
        let mut read = UncertaintyField::read(&first).unwrap();
        prop_assert_eq!(read.layers.names(), field.layers.names());
        if field.sums().is_some() && !field.is_part() {
            // Sums are rounded to their factors, which `kept_sums_answer_for_every_covariance` is about.
            (read.layers.sums, field.layers.sums) = (None, None);
            field.write(&first).unwrap();
        }
        prop_assert!(read == field);
        read.write(&second).unwrap();
        prop_assert!(std::fs::read(first).unwrap() == std::fs::read(second).unwrap());
    }
}
