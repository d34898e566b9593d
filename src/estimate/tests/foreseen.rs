//! What is foreseen of a run bounds what it takes.

use super::*;
use crate::estimate::{Checkpoint, Plan, Run};
use crate::posterior::Criterion;

/// A run of 100,000 rays, whose sums may take so many bytes in memory, if there is a bound.
fn with_run<T>(
    grid: GridSettings,
    room: Option<usize>,
    goal: Goal,
    checkpoint: Option<Checkpoint>,
    then: impl FnOnce(Run) -> T,
) -> T {
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(24, [128, 128]));
    let estimation = Estimation::new(&field, &cameras).rays(settings(100_000)).grid(grid).goal(goal);
    let mut run = match checkpoint {
        Some(checkpoint) => estimation.checkpoint(checkpoint),
        None => estimation,
    }
    .prepare()
    .unwrap();
    run.room = room;
    then(run)
}

#[test]
#[ignore = "slow: several seconds"]
fn vertices_and_sums_are_at_most_what_the_first_rays_foresee_and_not_much_less() {
    are_foreseen([(GridSettings::default().level(6).keep_sums(false), None, None)]);
}

#[test]
#[ignore = "slow: fourteen runs"]
fn vertices_sums_and_disk_are_at_most_what_the_first_rays_foresee_and_not_much_less() {
    let fine = GridSettings::default().level(8).keep_sums(false);
    let limited = fine.criteria([Criterion::RayCount].into_iter().collect());
    let (whole, groups) = (None, Some(3));
    let cases: [(GridSettings, Option<usize>, Option<u16>); 7] = [
        (fine, None, whole),
        (fine.keep_sums(true).level(10), None, whole),
        (limited, None, whole),
        (fine, Some(16 << 20), whole),
        (fine.level(9), Some(32 << 20), groups),
        (fine, None, groups),
        (GridSettings::default().level(5).grid(GridKind::Dense), None, whole),
    ];
    are_foreseen(cases);
}

/// Of grids, the room for their sums, and groups of rays.
fn are_foreseen(cases: impl IntoIterator<Item = (GridSettings, Option<usize>, Option<u16>)>) {
    for (grid, room, groups) in cases {
        let goal = Goal::of(None, None, groups);
        let before = with_run(grid, room, goal, None, |run| run.forecast().unwrap());
        let mut under_way = Vec::new();
        let outcome = with_run(grid, room, goal, None, |run| {
            let mut keep = |plan: &Plan| {
                under_way.push(plan.clone());
                Ok(())
            };
            run.finish_foreseen(&mut keep).unwrap()
        });
        assert_eq!(under_way.len(), 1, "once");
        for plan in [&before, &under_way[0]] {
            let found = [outcome.field.summary().vertices as f64, outcome.sums_bytes as f64, outcome.disk_bytes as f64];
            // Half of a small room is full after few rays; and these fill it with some 20 MB more.
            let most = if room.is_some() { [4.0, f64::INFINITY, 2.0] } else { [2.0; 3] };
            for (n, (bound, found)) in [plan.vertices, plan.summing, plan.disk].into_iter().zip(found).enumerate() {
                let is_bound = bound == found || (1.0..=most[n]).contains(&(bound / found));
                assert!(is_bound, "{grid:?}, {n}: {bound} foreseen, {found} found");
            }
            assert_eq!(plan.rays_per_vertex, grid.rays_per_vertex());
            assert_eq!(plan.given_up.is_empty(), !grid.is_limited());
        }
    }
}

#[test]
#[ignore = "slow: several seconds"]
fn a_plan_can_be_refused_and_a_resumed_run_has_none() {
    let grid = GridSettings::default().level(6);
    let refuse = &mut |_: &Plan| Err(Error::setting("memory", "more", "less"));
    let refused = with_run(grid, None, Goal::default(), None, |run| run.finish_foreseen(refuse).err());
    assert!(refused.is_some_and(|error| error.to_string().contains("memory")));
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = || Some(Checkpoint::new(folder.path().join("run.chk")));
    let mut plans = Vec::new();
    for _ in 0..2 {
        let mut count = 0;
        let mut keep = |_: &Plan| {
            count += 1;
            Ok(())
        };
        let foreseen = |run: Run| run.finish_foreseen(&mut keep).unwrap();
        with_run(grid, None, Goal::of(None, None, Some(2)), checkpoint(), foreseen);
        plans.push(count);
    }
    assert_eq!(plans, [1, 0], "the second run has no ray left to draw");
}
