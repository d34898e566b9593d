//! Files whose checksums are right, with one number that no run can give.
//!
//! `pixel_offset` of 1e160 passed once, and was a panic in `next-view`; below that, a wrong picture.

use std::path::Path;

use serde_json::{Value, json};

use super::*;
use crate::uncertainty::layers::tests::whole;

/// Writes a field anew after `change` of its header and its sections, with right lengths and checksums.
pub(in crate::uncertainty) fn forge(path: &Path, change: impl FnOnce(&mut Value, &mut Vec<Vec<u8>>)) {
    let bytes = std::fs::read(path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let (header, mut rest) = bytes[20..].split_at(length);
    let mut header: Value = serde_json::from_slice(header).unwrap();
    let mut sections = Vec::new();
    for section in header["sections"].as_array().unwrap() {
        let (own, behind) = rest.split_at(section["bytes"].as_u64().unwrap() as usize);
        sections.push(own.to_vec());
        rest = behind;
    }
    change(&mut header, &mut sections);
    for (described, bytes) in header["sections"].as_array_mut().unwrap().iter_mut().zip(&sections) {
        (described["bytes"], described["crc32"]) = (bytes.len().into(), crc32fast::hash(bytes).into());
    }
    let header = serde_json::to_vec(&header).unwrap();
    let words = [FORMAT_VERSION, header.len() as u32, crc32fast::hash(&header)].map(u32::to_le_bytes).concat();
    std::fs::write(path, [&bytes[..8], &words, &header, &sections.concat()].concat()).unwrap();
}

/// Reads `field` with this value at a place of its header's content: the message, if it is refused.
fn read_with(field: &UncertaintyField, place: &str, value: &Value) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.oct");
    field.write(&path).unwrap();
    forge(&path, |header, _| {
        let found = header.pointer_mut(&format!("/content{place}"));
        *found.unwrap_or_else(|| panic!("{place} is in the header")) = value.clone();
    });
    UncertaintyField::read(&path).err().map(|e| e.to_string())
}

#[test]
fn numbers_that_no_run_has_are_refused_by_name() {
    let in_data_scale = whole();
    let in_paper_scale = {
        let mut field = in_data_scale.clone();
        field.record = RunRecord { scale: Scale::Paper, lambda: 1e-6, ..field.record };
        field.record.difference_step = Some([0.1; 3]);
        field
    };
    let numbers = |numbers: &[f64]| numbers.iter().map(|n| json!(n)).collect::<Vec<Value>>();
    // The next number in f32 beyond, and those far beyond.
    let share = || (numbers(&[f64::from(1.0_f32.next_up()), 1e300, -1.0]), numbers(&[0.0, 0.5, 1.0]));
    let (smallest, largest) = (f64::from(f32::MIN_POSITIVE), f64::from(f32::MAX));
    let length = || (numbers(&[0.0, -1.0, 0.9 * smallest, 1.1 * largest, 1e300]), numbers(&[smallest, 1.0, largest]));
    let counts = (vec![json!(0), json!(-1), json!((1_u64 << 53) + 1), json!(u64::MAX)], vec![json!(1_u64 << 53)]);
    let record = [
        ("rays", counts.clone()),
        ("dropped", (vec![json!(-1), json!(3073), json!(u64::MAX)], vec![json!(0), json!(3072)])),
        ("shard/rays", counts.clone()),
        ("shard/index", (vec![json!(1), json!(-1), json!(u64::MAX)], vec![json!(0)])),
        ("shard/of", (vec![json!(0), json!(-1)], vec![json!(1)])),
        ("lambda", (numbers(&[0.0, -1.0, 1e-300, 1e300]), numbers(&[1e-60, 1.0]))),
        ("tolerance", (numbers(&[-1e-9, 1.1 * largest, 1e300]), numbers(&[0.0, 0.5, largest]))),
        ("march_step", length()),
        ("difference_step/1", length()),
        ("cutoff", share()),
        ("background/2", share()),
        ("pixel_offset", share()),
        ("pixel_angle", length()),
    ];
    let cases = record.into_iter().map(|(name, values)| (&in_paper_scale, format!("/record/{name}"), values));
    let data = |name: &str| format!("/record/scale/data/{name}");
    let own = DataScale::new(1000, 0.02, 0.05).unwrap();
    let in_header = [
        // The precision of the prior is theirs, so that no other numbers fit.
        (data("pixels"), (vec![json!(0), json!(999), json!(u64::MAX)], vec![json!(1000)])),
        (data("noise"), (numbers(&[0.0, -0.02, 0.51, 1e300]), numbers(&[own.noise]))),
        (data("prior_deviation"), (numbers(&[0.0, -0.05, 1e300]), numbers(&[own.prior_deviation]))),
        ("/layers/calibration/probability".into(), (numbers(&[0.0, 1.0, -0.5, 1e300]), numbers(&[1e-9, 0.999]))),
        ("/layers/calibration/factor".into(), (numbers(&[-1.0, 1.1 * largest, 1e300]), numbers(&[0.0, largest]))),
        ("/layers/calibration/pixels".into(), (vec![json!(1), json!((1_u64 << 53) + 1)], vec![json!(1_u64 << 53)])),
        ("/layers/calibration/views".into(), (vec![json!(0), json!(101)], vec![json!(1), json!(100)])),
        ("/layers/ray sets/0/shard/rays".into(), counts),
        ("/lattice/level".into(), (vec![json!(0), json!(17), json!(255)], vec![json!(6)])),
        ("/lattice/domain/Box/min/0".into(), (numbers(&[1.0, 2.0, -1e39, -1e300]), numbers(&[-1.0]))),
    ];
    let mut wrong = Vec::new();
    for (field, place, (refused, accepted)) in cases.chain(in_header.map(|(p, values)| (&in_data_scale, p, values))) {
        let words = ["record", "layers", "data"];
        let is_name = |part: &&str| !words.contains(part) && part.parse::<u8>().is_err();
        let name = place.split('/').filter(|part| !part.is_empty()).find(is_name).unwrap();
        for value in refused {
            let said = read_with(field, &place, &value);
            // A whole number that is negative or too large for its type has no name, but its place in the header.
            let is_named = |said: &String| said.contains(name) || said.contains("header") && said.contains("column");
            if !said.as_ref().is_some_and(is_named) {
                wrong.push(format!("{place} = {value}: {said:?}"));
            }
        }
        for value in accepted {
            wrong.extend(read_with(field, &place, &value).map(|said| format!("{place} = {value}: {said}")));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Elsewhere than in its part of space it would answer as if nothing had been seen.
#[test]
fn a_tile_of_an_earlier_version_is_no_field() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.oct");
    whole().write(&path).unwrap();
    forge(&path, |header, _| header["content"]["layers"]["tile"] = json!({ "index": 1, "of": 8 }));
    let said = UncertaintyField::read(&path).unwrap_err().to_string();
    assert!(said.contains("layer `tile`"), "{said}");
}

/// Gives a record a number.
type Set = fn(&mut RunRecord, f64);

/// JSON has no NaN and no infinity, but `1e999` and `null` in their place.
#[test]
fn a_header_has_no_infinite_number() {
    let record = whole().record;
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let with: [(&str, Set); 7] = [
            ("lambda", |r, v| (r.scale, r.lambda) = (Scale::Paper, v)),
            ("tolerance", |r, v| r.tolerance = v),
            ("march_step", |r, v| r.march_step = Some(v)),
            ("difference_step", |r, v| r.difference_step = Some([1.0, v, 1.0])),
            ("cutoff", |r, v| r.cutoff = Some(v)),
            ("background", |r, v| r.background = Some([0.0, 0.0, v as f32])),
            ("pixel_offset", |r, v| r.pixel_offset = Some(v)),
        ];
        for (name, set) in with {
            let mut forged = record.clone();
            set(&mut forged, number);
            assert_eq!(forged.impossible().map(|(name, ..)| name), Some(name), "{number}");
        }
    }
    assert_eq!(record.impossible(), None);
}

#[test]
fn entries_that_no_run_has_are_refused_by_section() {
    let field = whole();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.oct");
    let read = |section: &str, entry: &[u8]| {
        field.write(&path).unwrap();
        forge(&path, |header, sections| {
            let names = header["sections"].as_array().unwrap();
            let at = names.iter().position(|described| described["name"] == section).unwrap();
            // The second entry: error bars begin with their number of groups.
            let own = &mut sections[at];
            own[entry.len()..2 * entry.len()].copy_from_slice(entry);
        });
        UncertaintyField::read(&path).map_err(|e| e.to_string())
    };
    let prior = field.prior() as f32;
    let f32s = |v: f32| v.to_le_bytes().to_vec();
    let f16s = |v: f32| half::f16::from_f32(v).to_bits().to_le_bytes().to_vec();
    let most = by_vertex::encode(u32::MAX);
    for (section, refused, accepted) in [
        (
            "deviations",
            [f32::NAN, f32::INFINITY, 1e38, -1.0, 0.0, 1e-40, 1.001 * prior].map(f32s).to_vec(),
            [f32::MIN_POSITIVE, prior].map(f32s).to_vec(),
        ),
        ("rays", vec![vec![most + 1], vec![255]], vec![vec![0], vec![most]]),
        ("ray_coverage", vec![vec![most + 1], vec![255]], vec![vec![0], vec![most]]),
        ("factors", vec![[f32::NAN; 7].map(f32::to_le_bytes).concat()], vec![vec![0; 28]]),
        ("surface", [f32::NAN, f32::INFINITY].map(f32s).to_vec(), [-f32::MAX, 0.0].map(f32s).to_vec()),
        ("limits", vec![u64::MAX.to_le_bytes().to_vec()], vec![]),
        ("errors", [f32::INFINITY, -1.0, 1e6].map(f16s).to_vec(), [0.0, 65504.0].map(f16s).to_vec()),
    ] {
        for entry in refused {
            let said = read(section, &entry).expect_err(&format!("{section}: {entry:?}"));
            let of_points = section.replace(" points", "");
            assert!(said.contains(of_points.trim_end_matches('s')), "{section}, {entry:?}: {said}");
        }
        for entry in accepted {
            let found = read(section, &entry);
            assert!(found.is_ok(), "{section}, {entry:?}: {found:?}");
        }
    }
}
