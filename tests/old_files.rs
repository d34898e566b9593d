//! Fields of older versions can still be read, and give the answers that they gave when they were written.

use std::path::{Path, PathBuf};

use glam::Vec3;
use octobayes::rays::{Draw, Shard};
use octobayes::uncertainty::UncertaintyField;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// The rows of a CSV file after its header. Empty cells are `None`.
fn rows(path: &Path) -> Vec<Vec<Option<f64>>> {
    let mut reader = csv::ReaderBuilder::new().has_headers(true).from_path(path).unwrap();
    let cells = |row: csv::StringRecord| row.iter().map(|cell| cell.parse().ok()).collect();
    reader.records().map(|row| cells(row.unwrap())).collect()
}

#[test]
fn fields_of_versions_1_and_2_answer_as_before() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["version-1-octree", "version-1-dense", "version-1-f16", "version-2-error-bars"] {
        let old = UncertaintyField::read(&fixture(&format!("{name}.oct"))).unwrap();
        let has_bars = name == "version-2-error-bars";
        assert_eq!(old.error_bars().is_some(), has_bars, "{name}");
        assert_eq!((old.protocol().rays, old.surface().len()), (2000, 10), "{name}");
        // One sequence of pixels, or several that the file does not name.
        let one = vec![Draw { seed: 0, shard: Shard::whole(2000) }];
        assert_eq!(old.draws(), if has_bars { Vec::new() } else { one }, "{name}");
        // Written anew, it is the same field.
        let anew = folder.path().join("anew.oct");
        old.write(&anew).unwrap();
        let anew = UncertaintyField::read(&anew).unwrap();
        // Its sums are kept as factors now; the rest is as it was.
        assert_eq!(anew.without_sums(), old.clone().without_sums(), "{name}");
        let answers = rows(&fixture(&format!("{name}.csv")));
        assert_eq!(answers.len(), 4, "{name}");
        for row in answers {
            let [x, y, z, uncertainty] = std::array::from_fn(|i| row[i].unwrap());
            let found = old.query(Vec3::new(x as f32, y as f32, z as f32));
            // Written with all digits of an f64. Deviations in two bytes are read as f32 now.
            let rounding = if name == "version-1-f16" { f64::from(f32::EPSILON) * uncertainty } else { 0.0 };
            assert!((found.uncertainty - uncertainty).abs() <= rounding, "{name} at {x}, {y}, {z}");
            assert_eq!(found.log10_error, row.get(8).copied().flatten(), "{name} at {x}, {y}, {z}");
        }
    }
}
