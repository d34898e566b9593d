//! The points on visible surfaces that a field stores.

use super::*;
use crate::rays::Pixels;
use crate::uncertainty::merge;

#[test]
#[ignore = "slow: several seconds"]
fn a_share_of_visible_surfaces_is_that_of_pixels_that_the_field_did_not_draw() {
    // A ray lowers U where it passes. Of 10,000 rays, the points that they hit themselves have their 90 % where other
    // pixels have 69 %.
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(40, [400, 400]);
    for (own_rays, share) in [(40_000, 0.99), (10_000, 0.9)] {
        let grid = GridSettings::default().level(6);
        let run = Estimation::new(&field, &cameras).rays(settings(own_rays)).grid(grid).prepare().unwrap();
        let others = run.stream().with_pixels(Pixels::Random, 4711);
        let others = others.surface_points(usize::MAX, 200_000, &Silent).unwrap();
        let own = run.stream().surface_points(SURFACE_POINTS, own_rays, &Silent).unwrap();
        let found = run.finish().unwrap().field;
        let others: Vec<Vec3> = others.into_iter().map(Vec3::from_array).collect();
        let of_others = found.query_all(&others);
        let share_of = |field: &UncertaintyField| {
            let [limit] = field.surface_quantiles([share]).unwrap();
            of_others.iter().filter(|at| at.uncertainty.log10() <= limit).count() as f64 / of_others.len() as f64
        };
        // The points of a ray are near each other, so they count once. Five deviations of a share of so many rays;
        // those of the 200,000 other rays are a seventh of them.
        let rays = found.surface().len() as f64 / others.len() as f64 * 200_000.0;
        let tolerance = 5.0 * (share * (1.0 - share) / rays).sqrt();
        let of_found = share_of(&found);
        assert!((of_found - share).abs() <= tolerance, "{of_found} for {share}, within {tolerance}; {rays} rays");
        if own_rays < 40_000 {
            let of_own = share_of(&found.with_surface(own));
            assert!(of_own < share - 3.0 * tolerance, "what the test is for: {of_own}, within {tolerance}");
        }
    }
}

#[test]
fn every_part_of_a_run_has_its_points() {
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(6, [40, 40]);
    let start = |seed| {
        let rays = settings(3000).seed(seed);
        Estimation::new(&field, &cameras).rays(rays).grid(GridSettings::default().level(5))
    };
    let whole = start(1).run().unwrap().field;
    let parts = [0, 1, 2].map(|index| start(1).shard(index, 3).run().unwrap().field);
    assert!(whole.surface().len() > 1000 && parts.iter().all(|part| part.surface() == whole.surface()));
    assert_eq!(merge(&parts).unwrap().surface(), whole.surface());
    let grouped = start(1).error_bars(2).run().unwrap().field;
    assert_eq!(grouped.surface(), whole.surface());
    assert_ne!(start(2).run().unwrap().field.surface(), whole.surface(), "another seed has other points");
    // One of so many threads, and of splats: `the_number_of_threads_does_not_matter`.
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one.install(|| start(1).run().unwrap().field).surface(), whole.surface());
}
