//! Parts of space, each summed by itself, are the whole when joined: the same octree, the same numbers.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::program::outcome;
use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, Outcome, RaySettings};
use octobayes::export::{
    MeshSettings, surfaces, write_hyper_tree, write_leaves, write_mesh, write_points, write_report,
};
use octobayes::field::{ClosedForm, Intrinsics, TrainedField};
use octobayes::geometry::{Camera, Domain, Norm};
use octobayes::monitor::Silent;
use octobayes::octree::Tile;
use octobayes::posterior::{Covariance, Criterion, Pooling};
use octobayes::render::{Probe, RayAverage, VolumeRenderer, render_view};
use octobayes::uncertainty::{
    Answers, Estimate, Support, ThresholdedField, TiledField, UncertaintyField, compare, finish_tiles, merge,
};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

/// What a run on the courtyard gives, with these settings on top of the test's own.
fn run(grid: GridSettings, domain: Option<Domain>, shard: [u64; 2], tile: Option<Tile>) -> Outcome {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(5, [64, 48]));
    let estimation = Estimation::new(&scene, &cameras)
        .rays(RaySettings::default().rays(5_000).occupancy(48))
        .grid(grid.tile(tile).keep_sums(false))
        .shard(shard[0], shard[1]);
    domain.into_iter().fold(estimation, Estimation::domain).run().unwrap()
}

fn tiles(of: u32) -> impl Iterator<Item = Option<Tile>> {
    (0..of).map(move |index| Tile::new(index, of))
}

/// The first difference between two fields that must be equal in all that queries see.
fn difference(a: &UncertaintyField, b: &UncertaintyField) -> Option<&'static str> {
    let bits = |field: &UncertaintyField| field.deviations().iter().map(f64::to_bits).collect::<Vec<_>>();
    let parts = [
        ("octree", a.support() == b.support()),
        ("deviations", bits(a) == bits(b)),
        ("ray counts", a.rays() == b.rays()),
        ("ray_coverage", a.ray_coverage() == b.ray_coverage()),
        ("limits", a.limits() == b.limits()),
        ("ray_sets", a.ray_sets() == b.ray_sets()),
        ("record", a.record() == b.record()),
        ("sums", a.sums().is_none() && b.sums().is_none()),
    ];
    parts.into_iter().find(|(_, same)| !same).map(|(name, _)| name)
}

fn vertices(field: &UncertaintyField) -> usize {
    match field.support() {
        Support::Octree(octree) => octree.vertex_count(),
        Support::Dense => unreachable!("octrees only"),
    }
}

#[test]
#[ignore = "slow: minutes of whole runs as processes"]
fn tiles_joined_are_the_whole_bit_for_bit() {
    let grid = || GridSettings::default().level(6).covariance(Covariance::Block);
    let contracted = Domain::contracted([0.0, 0.0, 0.0].into(), 1.0, Norm::L2).unwrap();
    let cases = [
        ("plain", grid(), None, 8),
        ("coarser than the cells of ray coverage", grid(), None, 2),
        ("many", grid().level(5), None, 64),
        ("everything that moved", grid().tolerance(0.0), None, 4),
        ("coarse leaves are negligible", grid().tolerance(0.3), None, 8),
        (
            "limits",
            grid().level(7).criteria([Criterion::Sensitivity, Criterion::RayCount].into_iter().collect()),
            None,
            8,
        ),
        ("contracted", grid().level(5), Some(contracted), 8),
    ];
    for (name, grid, domain, of) in cases {
        let whole = run(grid, domain, [0, 1], None);
        let parts: Vec<Outcome> = tiles(of).map(|tile| run(grid, domain, [0, 1], tile)).collect();
        let (samples, rays): (Vec<u64>, Vec<u64>) =
            parts.iter().map(|part| (part.progress.samples, part.progress.rays)).unzip();
        assert!(rays.iter().all(|rays| *rays == whole.progress.rays), "{name}: {rays:?}");
        // Rays that miss a tile are not traced, but where they are curved on the lattice, or the largest leaf is as
        // large as the tile.
        let all = u64::from(of) * whole.progress.samples;
        let is_reached_by_all = domain.is_some() || grid.criteria.ray_count;
        let most = if is_reached_by_all { all } else { all * 9 / 10 };
        let traced: u64 = samples.iter().sum();
        assert!(traced >= whole.progress.samples && traced <= most, "{name}: {traced} of {}", whole.progress.samples);
        let mut parts: Vec<UncertaintyField> = parts.into_iter().map(|part| part.field).collect();
        // None has it all, so that joining them is no copy.
        assert!(parts.iter().all(|part| vertices(part) < 9 * vertices(&whole.field) / 10 || of == 2), "{name}");
        let joined = merge(&parts).unwrap();
        assert_eq!(difference(&joined, &whole.field), None, "{name}");
        let points = |field: &UncertaintyField| {
            let mut points: Vec<[u32; 3]> = field.surface().iter().map(|x| x.map(f32::to_bits)).collect();
            points.sort_unstable();
            points
        };
        assert!(!joined.surface().is_empty() && points(&joined) == points(&whole.field), "{name}");
        // In a folder, each tile answers by itself.
        let folder = tempfile::tempdir().unwrap();
        let paths = written(folder.path(), &parts);
        let finished = folder.path().join("tiles");
        std::fs::create_dir(&finished).unwrap();
        finish_tiles(&paths, &finished).unwrap();
        // Files round counts of ray coverage.
        let stored = folder.path().join("whole.oct");
        whole.field.write(&stored).unwrap();
        let stored = UncertaintyField::read(&stored).unwrap();
        let tiled = TiledField::open(&finished, 0).unwrap();
        assert_eq!((tiled.tiles(), difference(&tiled.joined().unwrap(), &stored)), (of as usize, None), "{name}");
        let points = probes(&whole.field);
        let (found, expected) = (tiled.answers(&points).unwrap(), stored.answers(&points).unwrap());
        let wrong = (0..points.len()).find(|&i| found[i] != expected[i]);
        assert!(wrong.is_none(), "{name}: {:?}", wrong.map(|i| (points[i], found[i], expected[i])));
        parts.reverse();
        assert_eq!(difference(&merge(&parts).unwrap(), &whole.field), None, "{name}, in another order");
    }
}

/// Points everywhere, on lattice planes where seams may be, on surfaces, and outside.
fn probes(field: &UncertaintyField) -> Vec<Vec3> {
    let lattice = field.lattice();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut chance = || rng.random::<f64>();
    let inside = |unit: [f64; 3]| lattice.domain().clamp(lattice.domain().to_scene(DVec3::from(unit)).as_vec3());
    let mut points: Vec<Vec3> = Vec::new();
    for i in 0..20_000 {
        let mut unit = [chance(), chance(), chance()];
        if i % 3 > 0 {
            // Halves, quarters and eighths of the cube.
            unit[i % 2] = (chance() * 8.0).round() / 8.0;
        }
        points.push(inside(unit));
    }
    points.extend(field.surface().iter().map(|&x| Vec3::from_array(x)));
    points.extend([Vec3::splat(1e9), Vec3::NAN, inside([1.0; 3]), inside([0.0; 3])]);
    points
}

/// Files of fields in a folder.
fn written(folder: &Path, fields: &[UncertaintyField]) -> Vec<PathBuf> {
    let write = |(i, field): (usize, &UncertaintyField)| {
        let path = folder.join(format!("part{i}.oct"));
        field.write(&path).unwrap();
        path
    };
    fields.iter().enumerate().map(write).collect()
}

/// The folder of a run's finished tiles, opened with room for one of them at a time.
fn opened_tiles(folder: &Path, of: u32) -> TiledField {
    let grid = GridSettings::default().level(6);
    let parts: Vec<UncertaintyField> = tiles(of).map(|tile| run(grid, None, [0, 1], tile).field).collect();
    let finished = folder.join("tiles");
    std::fs::create_dir(&finished).unwrap();
    finish_tiles(&written(folder, &parts), &finished).unwrap();
    TiledField::open(&finished, 0).unwrap()
}

#[test]
fn whoever_asks_tiles_gets_what_the_joined_field_says() {
    let folder = tempfile::tempdir().unwrap();
    let tiled = opened_tiles(folder.path(), 8);
    let joined = tiled.joined().unwrap();
    let fields: [&dyn Answers; 2] = [&tiled, &joined];
    let [found, expected] = fields.map(|field| field.summary().unwrap());
    assert_eq!((found.vertices, &found.leaves_per_level), (expected.vertices, &expected.leaves_per_level));
    // Vertices on seams are stored twice.
    assert!(found.query_bytes > expected.query_bytes && found.query_bytes < 2 * expected.query_bytes, "{found:?}");
    assert_eq!(fields[0].cells().unwrap(), fields[1].cells().unwrap());
    assert_eq!(fields[0].surface().unwrap(), fields[1].surface().unwrap());
    let quantiles = fields.map(|field| field.surface_quantiles([0.1, 0.9]).unwrap());
    assert!(quantiles[0].is_some() && quantiles[0] == quantiles[1], "{quantiles:?}");
    let same = compare(&tiled, &joined, 50_000, 0).unwrap();
    for difference in [&same.in_box, &same.on_surfaces] {
        assert_eq!(difference.as_ref().map(|d| (d.points > 1000, d.max)), Some((true, 0.0)));
    }
    // Pictures, and the clean-up in them. A threshold that removes some matter shows that tiles are asked there, too.
    let [threshold] = joined.surface_quantiles([0.5]).unwrap();
    let pictures = fields.map(|field| pictures(field, threshold));
    assert!(pictures[0] == pictures[1] && pictures[0][0] != pictures[0][1]);
}

/// Bits of colour and of ray averages of log10 U in a picture of the courtyard, as it is and cleaned.
fn pictures(field: &dyn Answers, threshold: f64) -> [Vec<[u64; 3]>; 2] {
    let (scene, camera) = (ClosedForm::courtyard(), ClosedForm::half_circle(5, [48, 40])[1]);
    let cleaned = ThresholdedField::new(&scene, field, threshold);
    let averages = [RayAverage::WeightedMean, RayAverage::USpreadPerRootRay];
    let models: [&dyn TrainedField; 2] = [&scene, &cleaned];
    let pictures = models.map(|model| {
        let tracer = RaySettings::default().occupancy(48).tracer(model, 0.0, &Silent).unwrap();
        let view = render_view(&tracer, &camera, 0.5, &[Probe { field, averages: &averages }], &Silent).unwrap();
        let [mean, spread] = &view.log10_uncertainty[..] else { panic!("one image for each average") };
        let pixel = |i: usize| [view.pixels[i].color.x, mean[i], spread[i]].map(f64::to_bits);
        (0..view.pixels.len()).map(pixel).collect()
    });
    cleaned.check().unwrap();
    pictures
}

#[test]
fn exports_of_tiles_are_those_of_the_joined_field() {
    let folder = tempfile::tempdir().unwrap();
    let tiled = opened_tiles(folder.path(), 4);
    let joined = tiled.joined().unwrap();
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(3, [32, 24]));
    let tracer = RaySettings::default().occupancy(48).tracer(&scene, 0.0, &Silent).unwrap();
    let renderer = VolumeRenderer { tracer, differentiation: None };
    let seen = surfaces(&renderer, &cameras, 0.5, 1_000, &Silent).unwrap();
    let names = ["a", "b", "c"].map(String::from);
    let settings = MeshSettings { resolution: 24, density: None };
    let write = |name: &str, path: &Path, field: &dyn Answers| match name {
        "npz" => write_leaves(path, field, None),
        "htg" => write_hyper_tree(path, field),
        "csv" => write_report(path, &seen, &names, field),
        "mesh" => write_mesh(path, &scene, field, settings, &Silent).map(|_| ()),
        _ => write_points(path, &seen, field, None),
    };
    for name in ["npz", "htg", "csv", "mesh", "points"] {
        let [found, expected] = [&tiled as &dyn Answers, &joined].map(|field| {
            let path = folder.path().join(name);
            write(name, &path, field).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(found == expected && found.len() > 500, "{name}: {} and {} bytes", found.len(), expected.len());
    }
}

#[test]
fn many_threads_ask_tiles_at_the_same_time() {
    let folder = tempfile::tempdir().unwrap();
    let tiled = opened_tiles(folder.path(), 8);
    let points = probes(&tiled.joined().unwrap());
    let expected = tiled.estimates(&points).unwrap();
    // Reading a tile works in parallel itself. While it waits for its parts, a thread may be given another question.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
    let all: Vec<Vec<Estimate>> =
        pool.install(|| points.par_chunks(points.len() / 64).map(|points| tiled.estimates(points).unwrap()).collect());
    let found = all.into_iter().flatten();
    assert!(found.zip(&expected).all(|(found, expected)| found == *expected));
}

#[test]
fn a_tile_that_is_gone_is_an_error_and_no_empty_space() {
    let folder = tempfile::tempdir().unwrap();
    let tiled = opened_tiles(folder.path(), 2);
    let scene = ClosedForm::courtyard();
    let cleaned = ThresholdedField::new(&scene, &tiled, 100.0);
    for tile in std::fs::read_dir(folder.path().join("tiles")).unwrap() {
        std::fs::remove_file(tile.unwrap().path()).unwrap();
    }
    assert!(tiled.estimates(&[Vec3::ZERO]).is_err() && tiled.cells().is_err());
    let camera = &ClosedForm::half_circle(2, [8, 8])[0];
    let render = |model: &dyn TrainedField, probes: &[Probe]| {
        let tracer = RaySettings::default().occupancy(16).tracer(model, 0.0, &Silent).unwrap();
        render_view(&tracer, camera, 0.5, probes, &Silent)
    };
    let probe = Probe { field: &tiled, averages: &[RayAverage::WeightedMean] };
    assert!(render(&scene, &[probe]).is_err());
    // A radiance field cannot say it itself.
    assert!(cleaned.check().is_ok() && render(&cleaned, &[]).is_ok());
    let message = cleaned.check().unwrap_err().to_string();
    assert!(message.contains(".oct"), "{message}");
}

#[test]
fn seams_are_where_refinement_crosses_them() {
    // The test above would show nothing if no leaf beyond a seam mattered: an octree of each tile by itself, cut at the
    // seams, is another.
    let grid = GridSettings::default().level(6);
    let whole = run(grid, None, [0, 1], None).field;
    let Support::Octree(octree) = whole.support() else { unreachable!() };
    let lonely = |tile: Tile| {
        let part = run(grid, None, [0, 1], Some(tile)).field;
        // With the box that the run gave it.
        let tile = part.tile().unwrap();
        let (Support::Octree(own), Some(sums)) = (part.support(), part.sums()) else { unreachable!() };
        let least = sums.iter().filter(|sums| sums.rays > 0).count();
        assert!(least > 0);
        // Vertices of the whole in this tile that the tile alone does not have.
        octree.vertex_positions().filter(|point| tile.owns(6, *point) && own.vertex(*point).is_none()).count()
    };
    let beyond: usize = tiles(8).flatten().map(lonely).sum();
    assert!(beyond > 10, "{beyond} vertices of tiles are due to other tiles");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn shards_of_tiles_are_the_shards_of_the_whole() {
    let grid = GridSettings::default().level(6);
    let of_shards: Vec<UncertaintyField> = (0..3).map(|i| run(grid, None, [i, 3], None).field).collect();
    let whole = merge(&of_shards).unwrap().for_queries();
    let parts = (0..3).flat_map(|i| tiles(4).map(move |tile| run(grid, None, [i, 3], tile).field));
    let parts: Vec<UncertaintyField> = parts.collect();
    let joined = merge(&parts).unwrap();
    assert_eq!(difference(&joined, &whole), None);
    // Nothing is missing in silence: neither a shard of a tile nor a tile.
    let message = |parts: &[UncertaintyField]| merge(parts).unwrap_err().to_string();
    assert!(message(&parts[1..]).contains("all shards of tile 0/4"), "{}", message(&parts[1..]));
    let no_tile = [&parts[1..4], &parts[5..8], &parts[9..]].concat();
    assert!(message(&no_tile).contains("none of 0/4"), "{}", message(&no_tile));
    // The shards of one tile are that tile.
    let one = merge(&[parts[1].clone(), parts[5].clone(), parts[9].clone()]).unwrap();
    assert_eq!((one.tile(), one.is_part()), (parts[1].tile(), true));
}

#[test]
fn what_does_not_belong_together_is_named() -> Result<()> {
    let folder = tempfile::tempdir().unwrap();
    let grid = GridSettings::default().level(5);
    let write = |name: &str, field: &UncertaintyField| {
        let path = folder.path().join(name);
        field.write(&path).map(|()| path)
    };
    let [a, b] = [0, 1].map(|index| run(grid, None, [0, 1], Tile::new(index, 2)).field);
    let [a, b] = [write("a.oct", &a)?, write("b.oct", &b)?];
    let whole = write("whole.oct", &run(grid.keep_sums(true), None, [0, 1], None).field)?;
    let quarter = write("quarter.oct", &run(grid, None, [0, 1], Tile::new(1, 4)).field)?;
    let deeper = write("deeper.oct", &run(grid.level(6), None, [0, 1], Tile::new(1, 2)).field)?;
    for (other, why) in [
        (&whole, "part of space of"),
        (&quarter, "part of space of"),
        (&deeper, "box and level of"),
        (&a, "rays in common"),
    ] {
        let message = merge(&[a.clone(), other.clone()]).unwrap_err().to_string();
        assert!(message.contains(why) && message.contains(&other.display().to_string()), "{message}");
    }
    // Files are what fields in memory are; the written field can be read like any other.
    let joined = merge(&[b.clone(), a.clone()])?;
    let path = write("joined.oct", &joined)?;
    assert_eq!(difference(&UncertaintyField::read(&path)?, &UncertaintyField::read(&whole)?.for_queries()), None);

    let octobayes = |args: &[&str]| Command::new(env!("CARGO_BIN_EXE_octobayes")).args(args).output().unwrap();
    let text = |path: &Path| path.display().to_string();
    let points = folder.path().join("points.csv");
    std::fs::write(&points, "0,0,0.5\n").unwrap();
    let refused = octobayes(&["query", &text(&a), &text(&points)]);
    let found = String::from_utf8_lossy(&refused.stderr).to_string();
    assert!(refused.status.code() == Some(2) && found.contains("tile 0/2"), "{found}");
    // A folder of tiles answers as the whole does.
    let tiles = folder.path().join("tiles");
    std::fs::create_dir(&tiles).unwrap();
    let merged = octobayes(&["merge", &text(&a), &text(&b), "-o", &text(&tiles)]);
    assert!(merged.status.success(), "{}", String::from_utf8_lossy(&merged.stderr));
    let [of_tiles, of_whole] = [&tiles, &whole].map(|field| octobayes(&["query", &text(field), &text(&points)]).stdout);
    assert_eq!(String::from_utf8_lossy(&of_tiles), String::from_utf8_lossy(&of_whole));
    let compared = octobayes(&["compare", &text(&tiles), &text(&whole), "--json"]);
    let compared: serde_json::Value = serde_json::from_slice(&compared.stdout).unwrap();
    assert_eq!(compared["in_box"]["max"], 0.0, "{compared}");
    // Neither a tile that is missing nor one of another run goes unnoticed.
    std::fs::copy(&quarter, tiles.join("quarter.oct")).unwrap();
    let refused = octobayes(&["query", &text(&tiles), &text(&points)]);
    let found = String::from_utf8_lossy(&refused.stderr).to_string();
    assert!(refused.status.code() == Some(2) && found.contains("1/4"), "{found}");

    let info = octobayes(&["info", &text(&a)]);
    let found = String::from_utf8_lossy(&info.stdout).to_string();
    assert!(info.status.success() && found.contains("tile             0 of 2"), "{found}");
    Ok(())
}

/// Numbers of vertices that rays touched in each of `of` tiles.
fn touched(scene: &ClosedForm, cameras: &[Camera], level: u8, of: u32) -> Vec<usize> {
    let count = |tile| {
        let estimation = Estimation::new(scene, cameras).rays(RaySettings::default().rays(6_000).occupancy(64));
        let field = estimation.grid(GridSettings::default().level(level).tile(tile)).run().unwrap().field;
        field.sums().unwrap().iter().filter(|sums| sums.rays > 0).count()
    };
    tiles(of).map(count).collect()
}

/// Halved along z, the upper tile of a city has nothing in it, and the lower one has all.
#[test]
#[ignore = "slow: whole runs as processes"]
fn tiles_have_as_many_vertices_wherever_the_scene_is() {
    let city = ClosedForm::named("city").unwrap();
    let intrinsics = Intrinsics { fov_x: None, resolution: Some([48, 36]) };
    let city_cameras = city.cameras(&intrinsics).unwrap().unwrap();
    for (name, scene, cameras, level) in [
        ("city", &city, city_cameras, 9),
        ("courtyard", &ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 48]), 7),
        ("ball", &ClosedForm::ball(), ClosedForm::half_circle(6, [64, 48]), 6),
    ] {
        for of in [2, 8] {
            let counts = touched(scene, &cameras, level, of);
            let mean = counts.iter().sum::<usize>() as f64 / counts.len() as f64;
            let most = *counts.iter().max().unwrap() as f64 / mean;
            assert!(most < 1.25, "{name}: {of} tiles have {counts:?}");
        }
    }
}

#[test]
fn all_tiles_of_a_run_are_cut_alike_whatever_the_threads_shards_and_seed() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(5, [64, 48]));
    let tile_of = |seed: u64, shard: [u64; 2], threads: usize, index: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let rays = RaySettings::default().rays(4_000).occupancy(48).seed(seed);
        let grid = GridSettings::default().level(6).tile(Tile::new(index, 4));
        let run = || Estimation::new(&scene, &cameras).rays(rays).grid(grid).shard(shard[0], shard[1]).run();
        pool.install(run).unwrap().field
    };
    let field = tile_of(0, [0, 1], 1, 2);
    assert!(field.tile().unwrap().is_cut());
    for (seed, shard, threads) in [(0, [0, 1], 3), (0, [2, 5], 2), (7, [0, 1], 2)] {
        assert_eq!(tile_of(seed, shard, threads, 2).tile(), field.tile(), "{seed} {shard:?} {threads}");
    }
    // So the tiles of two seeds are those of the rays of both.
    let parts: Vec<UncertaintyField> =
        (0..4).flat_map(|index| [0, 7].map(|seed| tile_of(seed, [0, 1], 2, index))).collect();
    let joined = merge(&parts).unwrap();
    let wholes = [0, 7].map(|seed| {
        let rays = RaySettings::default().rays(4_000).occupancy(48).seed(seed);
        let grid = GridSettings::default().level(6).tolerance(0.01).keep_sums(true);
        Estimation::new(&scene, &cameras).rays(rays).grid(grid).run().unwrap().field
    });
    let whole = merge(&wholes).unwrap();
    assert_eq!(joined.record().rays, 8_000);
    let same = compare(&joined, &whole, 20_000, 0).unwrap().in_box.unwrap();
    // Each seed alone may leave out what is negligible for its own rays.
    assert!(same.max <= 0.01 + 1e-6, "{}", same.max);
}

#[test]
fn a_tile_without_vertices_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let run = |tile: &str| {
        let args = format!(
            "uncertainty scene:ball --resolution 16 --rays 2000 --occupancy 16 --level 4 --tile {tile} -o tile.oct"
        );
        let (code, _, said) = outcome(folder.path(), &args);
        assert_eq!(code, Some(0), "{said}");
        said
    };
    let stderr = ["0/4096", "1/4096", "2047/4096", "4095/4096"].map(run);
    assert!(stderr.iter().any(|said| said.contains("has no vertex that a ray touched")), "{stderr:?}");
    assert!(!run("1/2").contains("no vertex"));
}

#[test]
fn settings_that_tiles_cannot_have_are_refused() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(2, [16, 16]));
    let grid = || GridSettings::default().level(3).tile(Tile::new(0, 8));
    let refused = |grid: GridSettings| {
        let estimation = Estimation::new(&scene, &cameras).rays(RaySettings::default().rays(512).occupancy(16));
        estimation.grid(grid).run().map(|_| ()).unwrap_err().to_string()
    };
    for (grid, why) in [
        (grid().pooling(Pooling::Auto), "pooling"),
        (grid().memory(1_u64 << 30), "memory budget"),
        (grid().criteria([Criterion::Density].into_iter().collect()), "density"),
        (grid().grid(octobayes::estimate::GridKind::Dense), "dense"),
        (grid().level(1).tile(Tile::new(0, 64)), "a level from 2 on"),
    ] {
        assert!(refused(grid).contains(why), "{}", refused(grid));
    }
    let estimation =
        || Estimation::new(&scene, &cameras).rays(RaySettings::default().rays(2048).occupancy(16)).grid(grid());
    assert!(estimation().error_bars(2).run().is_err() && estimation().until_mean_error(0.1).run().is_err());
    assert!(estimation().run().is_ok());
}
