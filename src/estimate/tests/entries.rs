//! Runs that sum no more of S than they read.

use super::*;

fn outcome(grid: GridSettings) -> Outcome {
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(6, [60, 60]);
    Estimation::new(&field, &cameras).rays(settings(6_000)).grid(grid.level(6)).run().unwrap()
}

#[test]
#[ignore = "slow: several seconds"]
fn a_field_without_sums_has_the_bits_of_one_with_them() {
    for covariance in Covariance::ALL {
        for ray_count in [false, true] {
            let mut grid = GridSettings::default().covariance(covariance);
            grid.criteria.ray_count = ray_count;
            let [with, without] = [true, false].map(|keeps| outcome(grid.keep_sums(keeps)).field);
            assert!(with.sums().is_some() && without.sums().is_none());
            assert!(with.without_sums() == without, "{covariance:?}, by ray count: {ray_count}");
        }
    }
}

/// By how much is tested in `posterior::octree`.
#[test]
fn a_run_that_reads_a_diagonal_takes_less_for_its_sums() {
    for covariance in Covariance::ALL {
        let grid = GridSettings::default().covariance(covariance);
        let [all, read] = [true, false].map(|keeps| outcome(grid.keep_sums(keeps)).sums_bytes);
        if covariance == Covariance::Block {
            assert_eq!(read, all, "a block has all entries");
        } else {
            assert!(read < all, "{covariance:?}: {read} of {all}");
        }
    }
}

#[test]
fn a_checkpoint_with_other_sums_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (field, cameras) = (ClosedForm::courtyard(), ClosedForm::half_circle(6, [60, 60]));
    let run = |grid: GridSettings| {
        let checkpoint = Checkpoint::new(folder.path().join("run.chk"));
        Estimation::new(&field, &cameras).rays(settings(30_000)).grid(grid.level(4)).checkpoint(checkpoint)
    };
    let diagonal = GridSettings::default().keep_sums(false);
    let monitor = After::rays(15_000);
    assert!(matches!(run(diagonal).monitor(&monitor).run(), Err(Error::Interrupted)));
    for other in [diagonal.keep_sums(true), diagonal.covariance(Covariance::Block), diagonal.grid(GridKind::Dense)] {
        let refused = run(other).run().err().unwrap().to_string();
        let said = if other.grid == GridKind::Dense { "run, grid" } else { "the diagonal of S, of another run" };
        assert!(refused.contains(said) && refused.contains("restart"), "{refused}");
    }
    // Whatever reads no more goes on.
    assert!(run(diagonal.covariance(Covariance::Trace)).run().is_ok());
}
