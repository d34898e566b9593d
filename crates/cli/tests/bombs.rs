//! Archives that unfold to a thousand times their size are refused by what their headers say, before they unfold.
//! Runs in a process of its own, because it counts all allocations.

mod arrays;

use std::alloc::System;
use std::io::{Read, Write};
use std::path::Path;

use arrays::npy;
use octobayes::octree::MaxLevels;
use octobayes_data::SamplesReader;
use octobayes_models::read_voxel_grid;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Elements of an array that is far too large: 64 MB of zeros.
const MANY: u64 = 1 << 24;

/// A deflated archive of f32 zeros.
fn write(path: &Path, arrays: &[(&str, &[u64])]) {
    let mut zip = ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, shape) in arrays {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        zip.start_file(format!("{name}.npy"), options).unwrap();
        zip.write_all(&npy::<f32>(shape, [])).unwrap();
        std::io::copy(&mut std::io::repeat(0).take(4 * shape.iter().product::<u64>()), &mut zip).unwrap();
    }
    zip.finish().unwrap().flush().unwrap();
}

// A single test, because the allocator counts for the whole process.
#[test]
fn wrong_shapes_are_refused_without_unfolding() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.npz");
    let corners: (&str, &[u64]) = ("box", &[2, 3]);
    let small: (&str, &[u64]) = ("density", &[2, 2, 2]);
    let color: (&str, &[u64]) = ("color", &[2, 2, 2, 3]);
    let voxels: [[(&str, &[u64]); 3]; 5] = [
        [("box", &[MANY]), small, color],
        [corners, ("density", &[MANY]), color],
        [corners, ("density", &[1, 1, MANY]), color],
        [corners, small, ("color", &[MANY])],
        [corners, small, ("color", &[2, 2, MANY, 3])],
    ];
    for arrays in voxels {
        write(&path, &arrays);
        let packed = std::fs::metadata(&path).unwrap().len();
        let region = Region::new(ALLOCATOR);
        let error = read_voxel_grid(&path).expect_err("a wrong shape").to_string();
        let taken = region.change().bytes_allocated;
        assert!(error.contains("expected shape") || error.contains("grid points per axis"), "{error}");
        assert!(packed < 1 << 20 && taken < 1 << 20, "{packed} bytes in the file took {taken}: {error}");
    }
    // Fine limits that stand alone: to balance each would take a thousand others.
    let alone: Vec<u64> = (0..20_000).map(|i| ((37 * i) << 8) | 16).collect();
    let region = Region::new(ALLOCATOR);
    assert_eq!(MaxLevels::from_packed(16, &[&[11], &alone[..]].concat()), None);
    let taken = region.change().bytes_allocated;
    assert!(taken < 1 << 20, "{taken}");
    write(&path, &[("positions", &[MANY, 2]), ("jacobian", &[2, 3, 3]), ("ray", &[2]), ("rays_total", &[1])]);
    let region = Region::new(ALLOCATOR);
    assert!(SamplesReader::open(&path).is_err());
    assert!(region.change().bytes_allocated < 1 << 20);
}
