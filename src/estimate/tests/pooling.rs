//! Pooled fields on different grids.

use super::*;

#[test]
fn pooled_fields_do_not_depend_on_the_tolerance() {
    // Which vertices count as moved was up to the tolerance: U differed by up to 1.95 decades.
    let field = ClosedForm::courtyard();
    let cameras = ClosedForm::half_circle(6, [64, 64]);
    let grid = |kind, tolerance: f64| {
        let grid = GridSettings { grid: kind, ..GridSettings::default() };
        grid.level(5).pooling(Pooling::Auto).tolerance(tolerance)
    };
    let octrees = [0.0, 1e-3, 0.01, 0.2].map(|tolerance| grid(GridKind::Octree, tolerance));
    let grids = [&[grid(GridKind::Dense, 0.0), grid(GridKind::Dense, 0.01)][..], &octrees].concat();
    let run = Estimation::new(&field, &cameras).rays(settings(4000)).grid(grids[0]).prepare().unwrap();
    let all = run.finish_on(&grids).unwrap();
    assert_eq!(all[0].field.deviations(), all[1].field.deviations(), "two dense grids");
    for (octree, settings) in all[2..].iter().zip(&octrees) {
        let compared = crate::uncertainty::compare(&octree.field, &all[0].field, 20_000, 1).unwrap();
        let most = compared.in_box.unwrap().max.max(compared.on_surfaces.unwrap().max);
        // The bound in the table of errors, and the rounding of two deviations to f32.
        assert_eq!(octree.errors.coarse_leaves, 0.01);
        assert!(most <= 0.01 + 1e-6, "tolerance {}: {most}", settings.tolerance);
    }
    let plain = GridSettings::default().level(5);
    let plain = Estimation::new(&field, &cameras).rays(settings(4000)).grid(plain).run().unwrap();
    let difference = crate::uncertainty::compare(&plain.field, &all[0].field, 20_000, 1).unwrap().on_surfaces.unwrap();
    assert!(difference.mean > 0.1, "the test's own premise: something is pooled, {difference:?}");
}
