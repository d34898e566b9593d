//! Sums that leave memory are those of a run that kept them.

use super::*;
use crate::posterior::Criterion;
use crate::uncertainty::compare;

/// A run whose sums may take so many bytes in memory, if there is a bound.
fn run(grid: GridSettings, room: Option<usize>, more: impl Fn(Estimation) -> Estimation) -> Outcome {
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let estimation = more(Estimation::new(&field, &cameras).rays(settings(20_000)).grid(grid));
    let mut run = estimation.prepare().unwrap();
    run.room = room;
    run.finish().unwrap()
}

fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

#[test]
#[ignore = "slow: several seconds"]
fn a_field_has_the_vertices_and_values_of_a_run_without_a_budget() {
    is_that_without_a_budget([(GridSettings::default().level(7).keep_sums(false), 1 << 20)]);
}

#[test]
#[ignore = "slow: nine runs"]
fn any_field_has_the_vertices_and_values_of_a_run_without_a_budget() {
    let fine = GridSettings::default().level(8);
    let limited = fine.criteria([Criterion::RayCount].into_iter().collect());
    is_that_without_a_budget([(fine, 4 << 20), (fine.keep_sums(false), 2 << 20), (limited, 1 << 20)]);
}

/// Of grids, and the room for their sums.
fn is_that_without_a_budget(cases: impl IntoIterator<Item = (GridSettings, usize)>) {
    for (grid, room) in cases {
        let free = run(grid, None, |run| run);
        let bound = [1, 3].map(|threads| on_threads(threads, || run(grid, Some(room), |run| run)));
        assert_eq!(free.disk_bytes, 0);
        for Outcome { field, progress, sums_bytes, disk_bytes, .. } in &bound {
            // Sums are looked at after rays with 65,536 samples.
            assert!((room..free.sums_bytes).contains(sums_bytes), "{sums_bytes} bytes of {}", free.sums_bytes);
            assert!(*disk_bytes > 2 * room as u64, "{disk_bytes} bytes on disk");
            assert!(field.support() == free.field.support() && *progress == free.progress);
            assert!(field.rays() == free.field.rays());
            // n ε of a sum, rounded to f32.
            assert!(compare(field, &free.field, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
        }
        assert!(bound[0].field == bound[1].field && bound[0].disk_bytes == bound[1].disk_bytes, "for any threads");
    }
}

/// Goals that have several sets of sums: groups of rays, and halves of them.
#[test]
#[ignore = "slow: fifteen runs"]
fn error_bars_and_mean_errors_are_those_of_runs_without_a_budget() {
    let grid = GridSettings::default().level(7).keep_sums(false);
    for (grid, room) in [(grid, 1 << 20), (grid, usize::MAX), (grid.pooling(Pooling::Auto).level(6), 1 << 20)] {
        let [free, bound] = [None, Some(room)].map(|room| run(grid, room, |run| run.error_bars(3)));
        // Sums of each group leave, whether or not all would fit.
        assert!(free.disk_bytes == 0 && bound.disk_bytes > 0 && bound.sums_bytes < free.sums_bytes);
        assert!(bound.field.support() == free.field.support() && bound.field.rays() == free.field.rays());
        assert!(compare(&bound.field, &free.field, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
        let [a, b] = [&bound, &free].map(|outcome| outcome.field.error_bars().unwrap().clone());
        // Errors are kept as f16: two that straddle a bound are a step of 2⁻¹⁰ apart. They are of differences of
        // log10 σ, which f32 rounds by 2.6e-8, times the number of groups.
        let off = |v: usize| a.get(v).zip(b.get(v)).map_or(0.0, |(a, b)| (a - b).abs() - b * 2.0_f64.powi(-10));
        assert!((0..a.len()).all(|v| a.get(v).is_some() == b.get(v).is_some() && off(v) < 3e-7));
        let threads = on_threads(3, || run(grid, Some(room), |run| run.error_bars(3)));
        assert!(threads.field == bound.field);

        let of = |room| run(grid, room, |run| run.until_mean_error(0.3));
        let [free, bound] = [None, Some(room / 2)].map(of);
        assert!(bound.field.support() == free.field.support() && bound.progress == free.progress);
        assert!(compare(&bound.field, &free.field, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
        let [a, b] = [&bound, &free].map(|outcome| match outcome.errors.rays {
            Some(RayError::Halves(error)) => error,
            other => panic!("{other:?}"),
        });
        // Sums differ by n ε. The error of pooled halves is a mean of bars, and few of these differ by a step of f16.
        assert!(a.vertices == b.vertices && (a.mean - b.mean).abs() < 1e-6 * b.mean, "{a:?}, {b:?}");
    }
}

#[test]
#[ignore = "slow: several seconds"]
fn groups_of_rays_resume_with_their_runs() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.chk");
    let (grid, room) = (GridSettings::default().level(7).keep_sums(false), 1 << 20);
    let whole = run(grid, Some(room), |run| run.error_bars(3));
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let again = |monitor: &dyn Monitor| {
        let estimation = Estimation::new(&field, &cameras).rays(settings(20_000)).grid(grid).monitor(monitor);
        let mut run = estimation.error_bars(3).checkpoint(Checkpoint::new(&file)).prepare().unwrap();
        run.room = Some(room);
        run.finish()
    };
    for rays in [3_000, 6_000, 1_000] {
        assert!(matches!(again(&After(AtomicU64::new(rays))), Err(Error::Interrupted)));
    }
    let outcome = again(&Silent).unwrap();
    assert!(outcome.field == whole.field && outcome.disk_bytes == whole.disk_bytes);
    Checkpoint::new(&file).remove(Some(3), &outcome.field).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "runs of all groups are gone");
}

/// More runs than are read side by side: they are merged under way, also in a run that is resumed behind that.
#[test]
#[ignore = "slow: four runs of 150,000 rays"]
fn many_runs_are_merged_under_way() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.chk");
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let of = |room: Option<usize>, monitor: &dyn Monitor, checkpoint: Option<Checkpoint>| {
        let grid = GridSettings::default().level(4).keep_sums(false);
        let estimation = Estimation::new(&field, &cameras).rays(settings(150_000)).grid(grid).monitor(monitor);
        let mut run = checkpoint.into_iter().fold(estimation, Estimation::checkpoint).prepare().unwrap();
        run.room = room;
        run.finish()
    };
    let [free, bound] = [None, Some(1)].map(|room| of(room, &Silent, None).unwrap());
    assert!(compare(&free.field, &bound.field, 20_000, 1).unwrap().in_box.unwrap().max < 1e-6);
    assert!(free.field.rays() == bound.field.rays());
    let after = || After(AtomicU64::new(140_000));
    assert!(matches!(of(Some(1), &after(), Some(Checkpoint::new(&file))), Err(Error::Interrupted)));
    let names = || std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name());
    // The checkpoint, the run of the first 64, and those after it.
    assert!(names().any(|name| name == "run.chk.run64") && (2..20).contains(&names().count()), "{:?}", names());
    let again = of(Some(1), &Silent, Some(Checkpoint::new(&file))).unwrap();
    assert!(again.field == bound.field);
    Checkpoint::new(&file).remove(None, &again.field).unwrap();
    assert_eq!(names().count(), 0);
}

#[test]
#[ignore = "slow: several seconds"]
fn a_resumed_run_has_the_same_bits_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.chk");
    let runs = || (0..).take_while(|n| folder.path().join(format!("run.chk.run{n}")).exists()).count();
    let (grid, room) = (GridSettings::default().level(8), 4 << 20);
    let whole = run(grid, Some(room), |run| run);
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [64, 64]));
    let again = |monitor: &dyn Monitor| {
        let estimation = Estimation::new(&field, &cameras).rays(settings(20_000)).grid(grid).monitor(monitor);
        let mut run = estimation.checkpoint(Checkpoint::new(&file)).prepare().unwrap();
        run.room = Some(room);
        run.finish()
    };
    // What a run left that was killed before its first state was saved.
    std::fs::write(folder.path().join("other"), "").unwrap();
    let mut found = 0;
    for rays in [8_000, 15_000] {
        assert!(matches!(again(&After(AtomicU64::new(rays))), Err(Error::Interrupted)));
        assert!(runs() > found, "{} runs after {rays} rays", runs());
        found = runs();
    }
    // A run of sums that was altered is found before or when it is read.
    let first = folder.path().join("run.chk.run0");
    let bytes = std::fs::read(&first).unwrap();
    let mut altered = bytes.clone();
    altered[4321] ^= 1;
    std::fs::write(&first, altered).unwrap();
    let error = again(&Silent).err().unwrap().to_string();
    assert!(error.contains("run.chk.run0") && error.contains("altered"), "{error}");
    std::fs::write(&first, bytes).unwrap();
    let outcome = again(&Silent).unwrap();
    assert!(outcome.field == whole.field && outcome.disk_bytes == whole.disk_bytes && runs() > found);
    Checkpoint::new(&file).remove(None, &outcome.field).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing but what was not its own");
}
