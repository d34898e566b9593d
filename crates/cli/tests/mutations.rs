//! Valid files of every kind, damaged in many ways. Readers refuse or accept them; what they accept can be used,
//! and nothing panics. Memory is bounded by what a file holds, not by what it claims.
//!
//! The fuzz targets in `fuzz/` test the same readers for longer.

mod untrusted;

use std::alloc::System;
use std::cell::Cell;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use octobayes::estimate::SURFACE_POINTS;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use untrusted::damage::{self, Damage};
use untrusted::{Kind, forge, probe, samples};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Runs one test at a time: the allocator counts for the whole process.
static ONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Bytes that a reader may allocate in total, freed ones included, for a file of `length` bytes.
///
/// The factor covers vectors that grow by doubling (3), and numbers that are shorter in the file than in memory (a
/// list of CBOR or JSON numbers takes 2 bytes an entry in the file and up to 24 in memory). It also covers
/// octrees: a mask of one byte stands for eight cells, whose vertices are found by sorting. Deflated archives grow
/// to at most 1032 times their size.
fn allowance(kind: Kind, length: usize) -> usize {
    let (fixed, factor) = match kind {
        // 8 cascades of 128³ cells, one byte each, and a window around them: the most that the format allows.
        Kind::Ppng => (120_000_000, 300),
        Kind::Field | Kind::Checkpoint => (2_000_000, 2000),
        Kind::Samples | Kind::Voxels => (2_000_000, 1100),
        // The window of a zstd stream (8 MB), and 4 MB of splats, which a tiny stream may unpack to.
        Kind::Splats => (60_000_000, 400),
        _ => (2_000_000, 300),
    };
    fixed + factor * length
}

/// Reads a file twice: once to count memory, once to use the result.
fn read(kind: Kind, folder: &Path, bytes: &[u8]) -> octobayes::Result<()> {
    let path = folder.join(kind.file_name());
    // Some file systems write a file to the disk at once if it is truncated, and not if it is new.
    let _ = std::fs::remove_file(&path);
    std::fs::write(&path, bytes).unwrap();
    let region = Region::new(ALLOCATOR);
    probe::open(kind, &path);
    let change = region.change();
    let taken = change.bytes_allocated;
    let limit = allowance(kind, bytes.len());
    assert!(taken <= limit, "{kind:?}: {taken} bytes taken for a file of {}, at most {limit} allowed", bytes.len());
    probe::read(kind, &path)
}

fn any_damage() -> impl Strategy<Value = Damage> {
    let place = || 0.0..1.0_f64;
    prop_oneof![
        (place(), any::<u8>()).prop_map(|(at, byte)| Damage::Set(at, byte)),
        (place(), 0..8_u8).prop_map(|(at, bit)| Damage::Flip(at, bit)),
        place().prop_map(Damage::Cut),
        (place(), 1..9_usize).prop_map(|(at, n)| Damage::Grow(at, n)),
        (place(), 1..40_usize).prop_map(|(at, n)| Damage::Remove(at, n)),
        (place(), place(), 1..200_usize).prop_map(|(from, to, n)| Damage::Copy(from, to, n)),
        (place(), prop::collection::vec(any::<u8>(), 1..9)).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
    ]
}

/// For each kind: its valid files, whole or in parts, and which damage happens to which part.
fn damaged(kind: Kind) -> impl Strategy<Value = (usize, bool, Vec<(f64, Damage)>)> {
    let files = samples::of(kind).len();
    (0..files, any::<bool>(), prop::collection::vec((0.0..1.0_f64, any_damage()), 1..5))
}

#[test]
fn valid_files_are_read() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    for kind in Kind::ALL {
        for (i, file) in samples::of(kind).iter().enumerate() {
            read(kind, folder.path(), file).unwrap_or_else(|e| panic!("{kind:?} {i}: {e}"));
            let forged = forge::file(kind, &forge::recipe(kind, file));
            read(kind, folder.path(), &forged).unwrap_or_else(|e| panic!("{kind:?} {i}, put together anew: {e}"));
        }
    }
}

#[test]
fn damaged_files_are_refused_or_harmless() {
    damage_files(40);
}

#[test]
#[ignore = "slow: many files"]
fn many_damaged_files_are_refused_or_harmless() {
    damage_files(600);
}

fn damage_files(cases: u32) {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let refused = Cell::new(0);
    for kind in Kind::ALL {
        let files = samples::of(kind);
        let mut runner = TestRunner::new(Config { cases, failure_persistence: None, ..Config::default() });
        let outcome = runner.run(&damaged(kind), |(file, by_parts, damages)| {
            let whole = &files[file];
            let bytes = damage::file(kind, whole, by_parts, &damages);
            let outcome = read(kind, folder.path(), &bytes);
            refused.set(refused.get() + u32::from(outcome.is_err()));
            // Checksums cover every byte of these kinds.
            if matches!(kind, Kind::Field | Kind::Checkpoint) && !by_parts && bytes != *whole {
                prop_assert!(outcome.is_err(), "an altered file was accepted");
            }
            Ok(())
        });
        outcome.unwrap_or_else(|e| panic!("{kind:?}: {e}"));
    }
    let refused = refused.get();
    assert!(refused > 4 * cases, "only {refused} files were damaged enough to be refused: the test damages too little");
}

/// A checksum alone proves nothing: a wrong one must be noticed in every part.
#[test]
fn every_byte_of_the_container_is_covered() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    for kind in [Kind::Field, Kind::Checkpoint] {
        for file in samples::of(kind) {
            let stride = (file.len() / 100).max(1);
            for at in (0..file.len()).step_by(stride) {
                assert!(read(kind, folder.path(), &file[..at]).is_err(), "{kind:?}: {at} bytes are enough");
                for bit in [1, 128] {
                    let mut bytes = file.clone();
                    bytes[at] ^= bit;
                    assert!(read(kind, folder.path(), &bytes).is_err(), "{kind:?}: byte {at} is not covered");
                }
            }
        }
    }
}

/// Archives have a checksum for every array. A reader that stops after the last element would not check it.
#[test]
fn every_array_of_an_archive_is_covered() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    for kind in [Kind::Voxels, Kind::Samples] {
        for file in samples::of(kind) {
            let recipe = forge::recipe(kind, &file);
            for part in forge::split(&recipe[1..]) {
                let at =
                    file.windows(part.len()).position(|bytes| bytes == part).expect("arrays are stored as they are");
                // The lowest bit of the last number: no other check can notice it.
                let low = at + part.len() - if part.len() % 8 == 0 { 8 } else { 4 };
                let mut bytes = file.clone();
                bytes[low] ^= 1;
                assert!(read(kind, folder.path(), &bytes).is_err(), "{kind:?}: byte {low} is not covered");
            }
        }
    }
}

/// A few bytes that claim much.
#[test]
fn small_files_that_claim_much_are_refused_without_the_memory() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let trillion = 1_000_000_000_000_u64;
    let array = |shape: &str, dtype: &str| {
        let header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({shape}), }}\n");
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &[0; 12]].concat()
    };
    let cbor = |write: &dyn Fn(&mut minicbor::Encoder<&mut Vec<u8>>)| {
        let mut bytes = Vec::new();
        write(&mut minicbor::Encoder::new(&mut bytes));
        bytes
    };
    let png = |side: u32| {
        let mut header = b"IHDR".to_vec();
        header.extend([side, side].iter().flat_map(|v| v.to_be_bytes()));
        header.extend([8, 6, 0, 0, 0]);
        let crc = crc32fast::hash(&header).to_be_bytes();
        let chunks = [&13_u32.to_be_bytes()[..], &header, &crc, &[0, 0, 0, 0], b"IEND", &[0xae, 0x42, 0x60, 0x82]];
        [b"\x89PNG\r\n\x1a\n".to_vec(), chunks.concat()].concat()
    };
    let container = |magic: &[u8], length: u64| {
        let header = format!(r#"{{"content":null,"sections":[{{"name":"sums","bytes":{length},"crc32":0}}]}}"#);
        let words = [1, header.len() as u32, crc32fast::hash(header.as_bytes())].map(u32::to_le_bytes).concat();
        [magic, &words, header.as_bytes()].concat()
    };
    let huge_header = [b"OCTOBAY\n".to_vec(), [1, u32::MAX, 0].map(u32::to_le_bytes).concat()].concat();
    let members = |parts: &[Vec<u8>]| forge::join(parts);
    let mut cases: Vec<(Kind, Vec<u8>)> = vec![
        (Kind::Points, array("1000000000000, 3", "<f4")),
        (Kind::Points, array("333333333333, 3", "<f8")),
        (Kind::Points, array("4611686018427387904, 4", "<f4")),
        (Kind::Official, array("1000000000000,", "<f4")),
        (
            Kind::Voxels,
            forge::file(Kind::Voxels, &members(&[array("2, 3", "<f4"), array("10000, 10000, 10000", "<f4")])),
        ),
        (
            Kind::Samples,
            forge::file(
                Kind::Samples,
                &members(&[array("1000000000000, 3", "<f4"), array("1000000000000, 3, 3", "<f4")]),
            ),
        ),
        (Kind::Field, huge_header),
        // The name of a version that is a trillion bytes long.
        (Kind::Checkpoint, {
            let run = bincode::encode_to_vec(trillion, bincode::config::standard()).unwrap();
            forge::file(Kind::Checkpoint, &members(&[b"null".to_vec(), run]))
        }),
        (Kind::Ppng, cbor(&|e| assert!(e.map(1).unwrap().str("poses").unwrap().array(trillion).is_ok()))),
        (Kind::Ppng, cbor(&|e| assert!(e.map(u64::MAX).unwrap().str("freqs").unwrap().array(u64::MAX).is_ok()))),
        (Kind::Ppng, [&[0xa1, 0x6a][..], b"qff_buffer", &[0x5b], &trillion.to_be_bytes()].concat()),
        (Kind::Safetensors, [&trillion.to_le_bytes()[..], b"{}"].concat()),
        (Kind::Safetensors, {
            let text = concat!(
                r#"{"fine.layer1.weight":{"dtype":"F32","shape":[1000000,1000000],"#,
                r#""data_offsets":[0,4000000000000]}}"#,
            );
            [&(text.len() as u64).to_le_bytes()[..], text.as_bytes()].concat()
        }),
        (Kind::Image, png(1_000_000)),
        (Kind::Image, png(16_384)),
        (
            Kind::Transforms,
            concat!(
                r#"{"fl_x": 1e6, "w": 1000000, "h": 1000000, "#,
                r#""frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]}]}"#,
            )
            .into(),
        ),
    ];
    for (kind, magic) in [(Kind::Field, b"OCTOBAY\n"), (Kind::Checkpoint, b"OCTOCHK\n")] {
        cases.extend([trillion, u64::MAX].map(|length| (kind, container(magic, length))));
    }
    for (i, (kind, bytes)) in cases.into_iter().enumerate() {
        assert!(bytes.len() < 700, "{} bytes are not few", bytes.len());
        let path = folder.path().join(kind.file_name());
        std::fs::write(&path, &bytes).unwrap();
        let region = Region::new(ALLOCATOR);
        let outcome = probe::open(kind, &path);
        let taken = region.change().bytes_allocated;
        assert!(!outcome, "case {i}, {kind:?}, was accepted");
        // Buffers: 64 KiB for reading, and those of decoders.
        assert!(taken < 1_000_000, "case {i}, {kind:?}: {taken} bytes taken");
        // Handled as damaged files are, including the message.
        assert!(read(kind, folder.path(), &bytes).is_err());
    }
}

/// Contents that no run writes, under correct checksums. Each was once accepted, or caused a panic later.
#[test]
fn contents_that_no_run_writes_are_refused() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let lambda = format!("\"lambda\":{}", serde_json::json!(samples::fields()[0].record().lambda));
    // Kind, sample, part, change, what the message names.
    type Change<'a> = &'a dyn Fn(&mut Vec<u8>);
    let cases: [(Kind, usize, usize, Change, &str); 23] = [
        // A mask too many, and too few deviations.
        (Kind::Field, 0, 1, &|masks| masks.push(0), "masks"),
        (Kind::Field, 0, 2, &|deviations| deviations.truncate(40), "deviations"),
        // Rays that are counted twice.
        (
            Kind::Field,
            5,
            0,
            &|header| {
                let text = String::from_utf8(header.clone()).unwrap();
                let (before, (sets, rest)) =
                    text.split_once("\"ray sets\":[").map(|(a, b)| (a, b.split_once(']').unwrap())).unwrap();
                *header = format!("{before}\"ray sets\":[{sets},{sets}]{rest}").into_bytes();
            },
            "ray sets",
        ),
        // A prior that is infinite.
        (
            Kind::Field,
            0,
            0,
            &|header| {
                let text = String::from_utf8(header.clone()).unwrap();
                *header = text.replacen(&lambda, "\"lambda\":1e-320", 1).into_bytes();
            },
            "header",
        ),
        (Kind::Field, 0, 2, &|deviations| deviations[..4].fill(0xff), "deviations"),
        // Off the diagonal, more than squares allow; on the diagonal, infinite only when added.
        (Kind::Field, 8, 5, &|sums| sums[8..16].copy_from_slice(&1e30_f64.to_le_bytes()), "sums"),
        (
            Kind::Field,
            8,
            5,
            &|sums| [0, 24, 40].into_iter().for_each(|at| sums[at..at + 8].copy_from_slice(&1e308_f64.to_le_bytes())),
            "sums",
        ),
        // A factor that is not finite, and one whose pivots have a seventh order.
        (Kind::Field, 0, 4, &|factors| factors[..4].fill(0xff), "factors"),
        (Kind::Field, 0, 4, &|factors| [3, 11, 23].into_iter().for_each(|at| factors[at] |= 0x80), "factors"),
        (Kind::Field, 0, 6, &|surface| surface[..4].fill(0xff), "surface"),
        // Ray counts of one vertex too many, and ray coverage of no grid.
        (Kind::Field, 0, 3, &|rays| rays.push(0), "rays"),
        (Kind::Field, 5, 7, &|ray_coverage| ray_coverage.truncate(7), "ray_coverage"),
        // Exact counts, which only parts keep: written again they would be rounded.
        (Kind::Field, 5, 8, &|counted| counted.extend([1, 0, 0, 0]), "counted"),
        // Error bars that are negative, and error bars of one group.
        (Kind::Field, 6, 10, &|errors| errors[3] = 0x80, "errors"),
        (Kind::Field, 6, 10, &|errors| errors[..2].copy_from_slice(&[1, 0]), "errors"),
        // A run with something behind it.
        (Kind::Checkpoint, 0, 1, &|run| run.push(0), "`run`"),
        // Keys of vertices: so coarse that a shift by their levels overflows, then coarse and outside.
        (Kind::Checkpoint, 0, 2, &|keys| keys[..8].copy_from_slice(&(40_u64 << 57).to_le_bytes()), "sums"),
        (Kind::Checkpoint, 0, 2, &|keys| keys[..8].copy_from_slice(&(3_u64 << 57 | 8).to_le_bytes()), "sums"),
        // A key of a vertex on leaves that the run does not have.
        (Kind::Checkpoint, 0, 2, &|keys| keys[..8].copy_from_slice(&(1_u64 << 57).to_le_bytes()), "sums"),
        // Negative sums: all of S, and its diagonal alone.
        (Kind::Checkpoint, 0, 3, &|sums| sums[7] |= 0x80, "sums"),
        (Kind::Checkpoint, 1, 3, &|sums| sums[7] |= 0x80, "sums"),
        // More points than the run keeps, and a point that is not finite.
        (Kind::Checkpoint, 0, 4, &|surface| surface.resize(12 * (SURFACE_POINTS + 1), 0), "surface"),
        (Kind::Checkpoint, 0, 4, &|surface| surface[..4].fill(0xff), "surface"),
    ];
    for (i, (kind, file, part, change, named)) in cases.into_iter().enumerate() {
        let recipe = forge::recipe(kind, &samples::of(kind)[file]);
        let mut parts: Vec<Vec<u8>> = forge::split(&recipe[1..]).into_iter().map(<[u8]>::to_vec).collect();
        change(&mut parts[part]);
        let outcome = read(kind, folder.path(), &forge::file(kind, &forge::join(&parts)));
        let error = outcome.expect_err(&format!("case {i} is accepted")).to_string();
        assert!(error.contains(named), "case {i}: {error}");
    }
}
