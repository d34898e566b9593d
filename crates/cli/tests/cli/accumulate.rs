//! `accumulate`: samples from elsewhere against NumPy, and our own samples, dumped and read back.

use std::path::Path;

use crate::program::Desk;
use octobayes::estimate::{FieldBuilder, FieldSource, GridKind, GridSettings};
use octobayes::geometry::{Aabb, Domain};
use octobayes::monitor::Silent;
use octobayes::posterior::{Information, trace};
use octobayes::rays::RunProgress;
use octobayes::render::RaySamples;
use octobayes::uncertainty::{Support, UncertaintyField};
use octobayes_data::SamplesReader;

/// `tests/numpy/write_samples.py` wrote the samples, `brute_force.py` the expected sums.
#[test]
fn samples_written_by_numpy_give_numpys_sums() {
    let numpy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/numpy");
    let (_, expected) = crate::answers::read_npy(&numpy.join("expected.npy"));
    let desk = Desk::empty();
    std::fs::copy(numpy.join("samples.npz"), desk.join("samples.npz")).unwrap();
    for (grid, kind) in [("dense", GridKind::Dense), ("octree", GridKind::Octree)] {
        let options = "--box=-1,-1,-1,1,1,1 --level 3 --tolerance 0 --keep-sums";
        desk.good(&format!("uncertainty samples.npz {options} --grid {grid} -o out.oct"));
        let read = desk.field("out.oct");
        let reader = SamplesReader::open(&desk.join("samples.npz")).unwrap();
        let settings = GridSettings::default().grid(kind).level(3).tolerance(0.0);
        let mut builder = FieldBuilder::new(settings, Domain::Box(Aabb::centered_cube(1.0))).unwrap();
        let add = |batches: &[RaySamples]| {
            builder.add(batches);
            Ok(())
        };
        reader.run(&Silent, add).unwrap();
        let progress = RunProgress { rays: reader.rays_total(), ..RunProgress::default() };
        let exact = builder.finish(&FieldSource { progress, ..FieldSource::default() }).unwrap();
        compare_with_numpy(&exact, &expected, 1e-14, grid);
        // Files keep factors in f32, each entry within 6e-8 of itself: six products of two entries.
        compare_with_numpy(&read, &expected, 4e-7, grid);
    }
}

/// Compares sums, relative to their trace. A vertex sums at most a few dozen products in f64.
fn compare_with_numpy(field: &UncertaintyField, expected: &[f64], precision: f64, grid: &str) {
    assert_eq!(field.record().rays, 150);
    let found = |[x, y, z]: [u32; 3]| -> Option<Information> {
        let vertex = match field.support() {
            Support::Dense => ((x * 9 + y) * 9 + z) as usize,
            Support::Octree(octree) => octree.vertex([x, y, z])?.0 as usize,
        };
        Some(field.sums().unwrap()[vertex].information)
    };
    let mut total = 0.0;
    for row in expected.chunks_exact(9) {
        let point = [row[0] as u32, row[1] as u32, row[2] as u32];
        let s = found(point).unwrap_or_else(|| panic!("{point:?} is a vertex"));
        let scale = trace(&s).max(row[3] + row[6] + row[8]);
        total += trace(&s);
        for k in 0..6 {
            assert!((s[k] - row[3 + k]).abs() <= precision * scale, "{grid} {point:?}: {s:?} against {:?}", &row[3..]);
        }
    }
    // There is nothing beyond what NumPy lists.
    let all: f64 = field.sums().unwrap().iter().map(|e| trace(&e.information)).sum();
    assert!((all / total - 1.0).abs() < 1e-12, "{grid}: {all} against {total}");
}

#[test]
fn dumped_samples_give_the_same_field_bit_for_bit() {
    let desk = Desk::new(6, 40);
    for grid in ["octree", "dense"] {
        let run = "uncertainty scene:courtyard --cameras cameras.json --level 6 --rays 20000 --occupancy 48";
        desk.good(&format!("{run} --grid {grid} --dump-samples samples.npz -o first.oct"));
        let sum = "uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 6 --threads 1";
        desk.good(&format!("{sum} --grid {grid} -o second.oct"));
        let [a, b] = ["first.oct", "second.oct"].map(|name| desk.field(name));
        assert_eq!(a.support(), b.support());
        // A field can hold neither NaN nor -0, so equal values have equal bits.
        assert_eq!((a.deviations(), a.sums()), (b.deviations(), b.sums()));
        // Samples from elsewhere bring no other rays, so that their surface points are where their own rays end.
        assert!(!a.surface().is_empty() && !b.surface().is_empty());
        assert_eq!((a.record().rays, a.record().lambda), (b.record().rays, b.record().lambda));
    }
}
