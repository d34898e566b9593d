//! The bytes that a field reports are those that the allocator gave. Runs in a process of its own, because it
//! counts all allocations.

use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Intrinsics, RadianceField};
use octobayes::uncertainty::{Support, UncertaintyField};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// What `make` returns, and the bytes allocated by it that are still held at its end.
fn held<T>(make: impl FnOnce() -> T) -> (usize, T) {
    let region = Region::new(ALLOCATOR);
    let made = make();
    let change = region.change();
    (change.bytes_allocated - change.bytes_deallocated, made)
}

fn city(level: u8, rays: u64) -> UncertaintyField {
    let city = ClosedForm::named("city").unwrap();
    let cameras = city.cameras(&Intrinsics::default()).unwrap().unwrap();
    let grid = GridSettings::default().level(level).surface_points(100);
    Estimation::new(&city, &cameras).rays(RaySettings::default().rays(rays)).grid(grid).run().unwrap().field
}

// A single test, because the allocator counts for the whole process.
#[test]
fn parts_add_up_to_what_was_allocated_and_structure_is_small() {
    let courtyard = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(8, [64, 64]);
    let rays = RaySettings::default().rays(10_000);
    let of = |grid, level| {
        let settings = GridSettings::default().grid(grid).level(level);
        Estimation::new(&courtyard, &cameras).rays(rays).grid(settings).run().unwrap().field
    };
    let fields = [of(GridKind::Octree, 7), of(GridKind::Dense, 5), city(10, 10_000), city(12, 10_000)];
    for field in fields {
        let file = tempfile::NamedTempFile::new().unwrap();
        field.write(file.path()).unwrap();
        let makes: [fn(&UncertaintyField) -> UncertaintyField; 2] = [Clone::clone, |f| f.clone().without_sums()];
        for make in makes {
            let (bytes, copy) = held(|| make(&field));
            check(bytes, &copy);
        }
        // A field read from a file holds no more than it needs, either.
        let (bytes, read) = held(|| UncertaintyField::read(file.path()).unwrap());
        check(bytes, &read);
        if let Support::Octree(octree) = field.support() {
            let structure: usize = octree.memory().iter().map(|part| part.1).sum();
            let per_vertex = structure as f64 / octree.vertex_count() as f64;
            assert!((0.1..=1.5).contains(&per_vertex), "{per_vertex} bytes of structure per vertex");
            let dense = 4.0 * field.lattice().dense_vertices() as f64;
            let least = match field.lattice().level() {
                10 => 40.0,
                12 => 150.0,
                _ => 2.0,
            };
            let ratio = dense / field.query_memory() as f64;
            assert!(ratio >= least, "1/{ratio} of the dense grid at level {}", field.lattice().level());
        }
    }
}

/// Strings of the protocol, and headers of vectors inside vectors, come on top of what `memory` lists.
fn check(allocated: usize, field: &UncertaintyField) {
    let listed: usize = field.memory().iter().map(|part| part.1).sum();
    assert!(listed <= allocated && allocated <= listed + 4096, "{listed} bytes listed, {allocated} allocated");
}
