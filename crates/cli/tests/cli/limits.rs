//! Limits in the user's own terms, as the binary takes them: memory, refinement criteria.

#![cfg(unix)]

use std::path::Path;
use std::process::Stdio;

use crate::interrupt::stopped;
use crate::program::{command, outcome};
use octobayes::estimate::{Estimation, GridKind, GridSettings, RaySettings};
use octobayes::field::ClosedForm;
use octobayes::posterior::{Covariance, Criteria, Criterion, Pooling};
use octobayes::uncertainty::{Support, UncertaintyField, compare, merge};
use octobayes_data::OfficialGrid;

const RUN: &str = "uncertainty scene:courtyard --resolution 64 --rays 10000 --occupancy 40";

fn good(folder: &Path, args: &str) -> String {
    let (code, _, said) = outcome(folder, args);
    assert_eq!(code, Some(0), "{args}: {said}");
    said
}

fn refused(folder: &Path, args: &str) -> String {
    let (code, _, said) = outcome(folder, args);
    assert_eq!(code, Some(2), "{args}: {said}");
    said
}

fn read(folder: &Path, name: &str) -> UncertaintyField {
    UncertaintyField::read(&folder.join(name)).unwrap()
}

/// Under a budget, sums go to disk, and the field stays what it is, to the last bits of sums in another order.
#[test]
#[ignore = "slow: whole runs as processes"]
fn a_budget_is_foreseen_and_changes_no_vertex() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("disk")).unwrap();
    let run = format!("{RUN} --level 10");
    good(folder, &format!("{run} -o free.oct"));
    let bound = format!("{run} --memory 100MB");
    let needs = |args: &str| -> serde_json::Value {
        let (code, said, stderr) = outcome(folder, &format!("{args} --dry-run --json"));
        assert_eq!(code, Some(0), "{stderr}");
        serde_json::from_str(&said).unwrap()
    };
    assert_eq!(needs(&run)["disk_bytes"], 0.0);
    let foreseen = needs(&bound)["disk_bytes"].as_f64().unwrap();
    let (code, said, stderr) = outcome(folder, &format!("{bound} --scratch disk -o bound.oct --json"));
    assert_eq!(code, Some(0), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&said).unwrap();
    let [disk, sums] = ["disk_bytes", "posterior_bytes"].map(|key| report[key].as_f64().unwrap());
    assert!(disk > 3e7 && (1.0..=2.0).contains(&(foreseen / disk)), "{disk} bytes on disk, {foreseen} foreseen");
    // 70 % of what is left beside 48 MB and the model, and what rays with 65,536 samples add at most: at this level
    // each sample touches eight vertices of some 40 bytes.
    assert!((3.6e7..3.7e7 + 2.1e7).contains(&sums), "{sums} bytes in memory");
    assert_eq!(std::fs::read_dir(folder.join("disk")).unwrap().count(), 0);
    let [free, bound] = ["free.oct", "bound.oct"].map(|name| read(folder, name));
    assert_eq!(free.support(), bound.support());
    // n ε of a sum, rounded to f32.
    assert!(compare(&free, &bound, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
    // A budget that cannot be kept says what could.
    let stderr = refused(folder, &format!("{RUN} --level 9 --memory 5kB -o x.oct"));
    assert!(stderr.contains("--memory") && stderr.contains("at least"), "{stderr}");
    let stderr = refused(folder, &format!("{RUN} --level 8 --grid dense --memory 100MB -o x.oct"));
    assert!(stderr.contains("--memory") && stderr.contains("at least"), "{stderr}");
    let stderr = refused(folder, &format!("{run} --memory 100MB --scratch nowhere -o x.oct"));
    assert!(stderr.contains("nowhere"), "{stderr}");
    assert!(!folder.join("x.oct").exists());
}

/// A run under a budget is stopped, by Ctrl-C and by kill -9, and goes on to the same bytes; nothing is left behind.
#[test]
#[ignore = "slow: whole runs as processes"]
fn sums_on_disk_survive_with_the_checkpoint_and_go_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = format!("{} --level 10 --memory 100MB", RUN.replace("10000", "40000"));
    good(folder, &format!("{run} -o whole.oct"));
    let resumable = format!("{run} -o again.oct --checkpoint run.chk");
    let runs = || (0..).take_while(|n| folder.join(format!("run.chk.run{n}")).exists()).count();
    let mut most = 0;
    for signal in ["-INT", "-KILL", "-KILL"] {
        let child = command(folder, &resumable).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        // A checkpoint appears with every run of sums.
        let next = folder.join(format!("run.chk.run{}", runs()));
        let output = stopped(&next, child, signal);
        assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(runs() > most, "{} runs after {signal}, {most} before", runs());
        most = runs();
    }
    // Without its sums, or with others, it does not go on.
    let (name, aside) = (folder.join("run.chk.run0"), folder.join("aside"));
    std::fs::rename(&name, &aside).unwrap();
    assert!(refused(folder, &resumable).contains("run.chk.run0"));
    std::fs::copy(folder.join("run.chk.run1"), &name).unwrap();
    assert!(refused(folder, &resumable).contains("the file that the checkpoint names"));
    std::fs::rename(&aside, &name).unwrap();
    assert!(refused(folder, &resumable.replace("--memory 100MB", "")).contains("--memory"));
    good(folder, &resumable);
    assert_eq!(std::fs::read(folder.join("whole.oct")).unwrap(), std::fs::read(folder.join("again.oct")).unwrap());
    let left: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "two fields: {left:?}");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn a_limited_run_survives_and_merges() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let limited = format!("{RUN} --level 8 --refine ray-count --tolerance 0");
    good(folder, &format!("{limited} -o whole.oct"));
    // Stopped under way, a run resumes with its own limits.
    let resumable = format!("{limited} --error-bars 8 -o again.oct --checkpoint run.chk");
    let child = command(folder, &resumable).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let output = stopped(&folder.join("run.chk.0"), child, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    good(folder, &format!("{limited} --error-bars 8 -o bars.oct"));
    // Only a run with the same limits may continue it.
    let other = resumable.replace("--refine ray-count", "--refine sensitivity");
    assert!(refused(folder, &other).contains("run, limits"));
    good(folder, &resumable);
    assert_eq!(std::fs::read(folder.join("bars.oct")).unwrap(), std::fs::read(folder.join("again.oct")).unwrap());
    for shard in 0..2 {
        good(folder, &format!("{limited} --shard {shard}/2 -o part{shard}.oct"));
    }
    good(folder, "merge part0.oct part1.oct -o merged.oct");
    let [whole, merged] = ["whole.oct", "merged.oct"].map(|name| read(folder, name));
    assert_eq!((whole.support(), whole.limits()), (merged.support(), merged.limits()));
    assert!(!whole.limits().is_unlimited());
    // Sums in another order, rounded to f32.
    assert!(compare(&whole, &merged, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
    good(folder, &format!("{RUN} --level 8 --tolerance 0 --seed 1 -o other.oct"));
    assert!(refused(folder, "export whole.oct -o x.npy").contains("coarser leaves"));
    let stderr = refused(folder, "merge whole.oct other.oct -o x.oct");
    assert!(stderr.contains("criteria") || stderr.contains("limits"), "{stderr}");
}

#[test]
fn criteria_refine_where_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let vertices = |refine: &str| {
        good(folder, &format!("{RUN} --level 6 --refine {refine} -o field.oct"));
        let field = read(folder, "field.oct");
        let Support::Octree(octree) = field.support() else { panic!("an octree was asked for") };
        (octree.vertex_count(), field)
    };
    let (sensitive, field) = vertices("sensitivity");
    assert_eq!(field.record().criteria, Criteria::default());
    let (dense, _) = vertices("density");
    let (both, _) = vertices("sensitivity,density");
    assert!(sensitive < both && dense < both && both < 65 * 65 * 65, "{sensitive} {dense} {both}");
}

/// An octree refined everywhere is the dense grid, bit for bit.
#[test]
fn the_dense_grid_is_a_uniform_octree() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let dense = GridSettings::default().level(6).grid(GridKind::Dense);
    let uniform = dense.grid(GridKind::Octree).criteria([Criterion::Uniform].into_iter().collect());
    let run = |grid| Estimation::new(&scene, &cameras).rays(RaySettings::default().rays(20_000)).grid(grid);
    let [of_grid, of_octree] = [dense, uniform].map(|grid| run(grid).run().unwrap().field);
    let Support::Octree(octree) = of_octree.support() else { panic!("an octree") };
    assert_eq!(octree.vertex_count(), 65 * 65 * 65);
    assert_eq!(compare(&of_octree, &of_grid, 20_000, 1).unwrap().in_box.unwrap().max, 0.0);
    // Shards of such a run merge into one field.
    let parts = [0, 1].map(|index| run(uniform).shard(index, 2).run().unwrap().field);
    assert_eq!(merge(&parts).unwrap().support(), of_octree.support());
    let error = run(uniform.level(10)).run().err().unwrap().to_string();
    assert!(error.contains("level up to 9"), "{error}");
}

/// Neither who draws the rays nor the octree changes what pooling makes of them.
#[test]
#[ignore = "slow: whole runs as processes"]
fn pooled_parts_merge_to_the_pooled_whole_which_is_that_of_the_dense_grid() {
    let (scene, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let grid = GridSettings::default().level(6).pooling(Pooling::Auto);
    let run = |grid| Estimation::new(&scene, &cameras).rays(RaySettings::default().rays(10_000)).grid(grid);
    let [whole, dense] = [grid, grid.grid(GridKind::Dense)].map(|grid| run(grid).run().unwrap().field);
    let parts = [0, 1, 2].map(|index| run(grid).shard(index, 3).run().unwrap().field);
    let merged = merge(&parts).unwrap();
    assert_eq!(merged.support(), whole.support());
    let [parts, kinds] = [&merged, &dense].map(|other| compare(&whole, other, 20_000, 1).unwrap().in_box.unwrap());
    // Sums in another order, rounded to f32; and what is negligible is left out.
    assert!(parts.max < 1e-6, "{}", parts.max);
    assert!(kinds.max <= 0.01 + 1e-6, "{}", kinds.max);
    let plain = run(grid.pooling(Pooling::Off)).run().unwrap().field;
    assert!(compare(&whole, &plain, 20_000, 1).unwrap().in_box.unwrap().mean > 0.01, "pooling changes something");
}

#[test]
fn contracted_fields_are_made_stored_and_asked_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder, &format!("{RUN} --level 6 --contract l2:0,0,-0.3,0.5 --keep-sums -o all.oct"));
    let field = read(folder, "all.oct");
    assert!(field.lattice().domain().bounds().is_none());
    let far = field.query(glam::Vec3::new(1e20, 0.0, 0.0));
    assert!(far.inside && (far.uncertainty / field.prior() - 1.0).abs() < 1e-6);
    let (_, info, _) = outcome(folder, "info all.oct");
    assert!(info.contains("L2 contraction outside 0.5"), "{info}");
    let stderr = refused(folder, &format!("{RUN} --contract l2 -o x.oct"));
    assert!(stderr.contains("l2:x,y,z,r"), "{stderr}");
    // The official code's grid of a contracted scene has the same lattice, in contracted coordinates.
    good(folder, "export all.oct -o x.npy");
    let (domain, rays) = (*field.lattice().domain(), field.record().rays);
    let official = OfficialGrid { domain, rays, lambda: None }.read(&folder.join("x.npy")).unwrap();
    let trace = field.clone().with_covariance(Covariance::Trace).unwrap();
    let mut moved = 0;
    for point in field.surface() {
        let x = glam::Vec3::from_array(*point);
        let (found, expected) = (official.log10(x), trace.log10(x));
        // The octree is within its tolerance of the dense grid, which the file holds.
        assert!((found - expected).abs() < 0.02, "{x}: {found} against {expected}");
        moved += usize::from(expected < field.prior().log10() - 1.0);
    }
    assert!(moved > 100, "{moved} points on surfaces that are known");
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn parts_under_a_budget_merge_to_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = format!("{RUN} --level 10");
    good(folder, &format!("{run} -o whole.oct"));
    for index in 0..3 {
        good(folder, &format!("{run} --memory 100MB --shard {index}/3 -o part{index}.oct"));
    }
    good(folder, "merge part0.oct part1.oct part2.oct -o merged.oct");
    let [whole, merged] = ["whole.oct", "merged.oct"].map(|name| read(folder, name));
    assert_eq!(whole.support(), merged.support());
    assert!(compare(&whole, &merged, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
}

#[test]
fn a_picture_is_part_of_the_plan_if_there_is_room_for_it() {
    let (scene, cameras) = (ClosedForm::ball(), ClosedForm::half_circle(2, [16; 2]));
    let run = |bytes: u64, memory: Option<u64>| {
        let rays = RaySettings::default().rays(600).occupancy(16);
        let estimation = Estimation::new(&scene, &cameras).rays(rays).picture(bytes);
        estimation.grid(GridSettings::default().level(3).memory(memory)).prepare().unwrap()
    };
    let plan = |bytes, memory| run(bytes, memory).forecast().unwrap();
    let [without, with] = [0, 1 << 30].map(|bytes| plan(bytes, None));
    assert!(without.peak() < without.outside + 2e7 && with.peak() == with.outside + f64::from(1 << 30), "{with:?}");
    let budget = 4 << 30;
    assert!(plan(1 << 30, Some(budget)).peak() > f64::from(1 << 30));
    assert!(plan(budget, Some(budget)).peak() < f64::from(1 << 30));
    let room = run(0, Some(budget)).room_for_pictures().unwrap();
    assert!(room < budget && room > budget / 2, "{room}");
    assert_eq!(run(0, None).room_for_pictures(), None);
}
