//! `--scale data`: deviations in scene units, from the command line.

use crate::program::Desk;
use octobayes::posterior::Scale;
use octobayes::uncertainty::{Observability, UncertaintyField};

const RUN: &str = "uncertainty scene:ball --cameras cameras.json --level 5 --rays 4000 --occupancy 32";

#[test]
fn more_pixels_and_less_noise_make_a_scene_more_certain() {
    let desk = Desk::new(4, 32);
    desk.good(&format!("{RUN} --scale data --noise 0.03162277660168379 --keep-sums -o data.oct"));
    let field = desk.field("data.oct");
    let Scale::Data(data) = field.record().scale else { panic!("the scale is stored") };
    // All pixels of the cameras, the noise of 30 dB, 0.02 of the longest edge.
    let edge = field.lattice().domain().size().max_element();
    assert_eq!((data.pixels, data.prior_deviation), (4 * 32 * 32, 0.02 * edge));
    assert!((data.noise.powi(2) - 1e-3).abs() < 1e-15);
    assert!((field.prior() / (3_f64.sqrt() * 0.02 * edge) - 1.0).abs() < 1e-6);

    // A tenth of the noise's square: up to ten times as much is known, beside the prior.
    desk.good(&format!("{RUN} --scale data --noise 0.01 -o sharp.oct"));
    let sharp = desk.field("sharp.oct");
    let x = glam::Vec3::from_array(field.surface()[0]);
    let [one, ten] = [&field, &sharp].map(|field| field.query(x).uncertainty);
    assert!(ten < one && one < field.prior() && one < 10_f64.sqrt() * 1.001 * ten, "{ten}, {one}");
    // Rays only sample the pixels: twice as many leave the posterior where it is, to their own noise of some tenths.
    desk.good(&format!("{} --scale data --noise 0.03162277660168379 -o more.oct", RUN.replace("4000", "8000")));
    let more = desk.field("more.oct");
    let median = |field: &UncertaintyField| field.surface_quantiles([0.5]).unwrap()[0];
    assert!((median(&more) - median(&field)).abs() < 0.15, "{} and {}", median(&more), median(&field));

    // The two scales are not compared in silence, and a field says which it has.
    desk.good(&format!("{RUN} -o paper.oct"));
    desk.refused("compare paper.oct data.oct", &["scale of data.oct", "`paper`"]);
    desk.good("compare paper.oct data.oct --force --points 1000");
    assert!(desk.good("info data.oct").contains("a deviation in scene units, from 4096 pixels of noise 0.0316"));
    assert!(desk.good("info paper.oct").contains("not a length"));
    let value = desk.json("info paper.oct");
    assert_eq!((&value["answers"]["sums"], &value["answers"]["ray coverage"]), (&false.into(), &true.into()));
}

/// What a purpose needs is set unless it is given, and noted; a dry run plans the same.
#[test]
fn a_purpose_sets_what_its_verb_needs() {
    let desk = Desk::empty();
    let run_for = |options: &str| {
        let run = "uncertainty scene:ball --rays 2000 --resolution 24 --occupancy 16 -o f.oct";
        let said = desk.said(&format!("{run} {options}"));
        (desk.field("f.oct"), said)
    };
    let (field, said) = run_for("--for depth --noise 0.05 --level 4");
    assert!(said.contains("sets --covariance block, --scale data\n"), "{said}");
    assert!(matches!(field.record().scale, Scale::Data(_)) && field.sums().is_none());
    assert_eq!((field.lattice().level(), field.record().covariance.name()), (4, "block"));
    let (field, said) = run_for("--for ranking --covariance trace");
    assert!(said.contains("sets --level 6\n"), "{said}");
    assert_eq!((field.lattice().level(), field.record().covariance.name()), (6, "trace"));
    let (_, said) = run_for("--for next-view --noise 0.05 --level 4 --scale data --keep-sums");
    assert!(!said.contains("sets"), "{said}");
    let dry = "uncertainty scene:ball --for ranking --dry-run --resolution 24 --occupancy 16 --rays 2000";
    assert_eq!(desk.json(dry)["level"], 6);
    // An answer that is no length comes with a note; one that is comes without.
    run_for("--level 4");
    assert!(desk.said("query f.oct 0,0,0").contains("is no length"));
    run_for("--level 4 --scale data --noise 0.05");
    assert_eq!(desk.said("query f.oct 0,0,0"), "");
}

/// Whether images say something of a place does not depend on what U is a deviation of.
#[test]
fn what_was_seen_is_the_same_on_both_scales() {
    let desk = Desk::empty();
    let run = "uncertainty scene:courtyard --level 6 --rays 50000 --resolution 64 --occupancy 64";
    desk.good(&format!("{run} -o paper.oct"));
    desk.good(&format!("{run} --scale data --noise 0.03162277660168379 -o data.oct"));
    let fields = ["paper.oct", "data.oct"].map(|name| desk.field(name));
    let words = |x: glam::Vec3| [0, 1].map(|i| fields[i].observability(x, fields[i].query(x).uncertainty).unwrap());
    let at = |n: i32| -0.99 + 1.98 * n as f32 / 30.0;
    let points = (0..31 * 31 * 31).map(|n| glam::Vec3::new(at(n / 961), at(n / 31 % 31), at(n % 31)));
    let grid: Vec<_> = points.map(words).collect();
    let surface: Vec<_> = fields[0].surface().iter().map(|x| words(glam::Vec3::from_array(*x))).collect();
    for (what, words, least) in [("grid", grid, 0.95), ("surface", surface, 0.98)] {
        let same = words.iter().filter(|[a, b]| a == b).count() as f64 / words.len() as f64;
        let constrained: Vec<_> = words.iter().filter(|[a, _]| *a == Observability::Constrained).collect();
        let kept = constrained.iter().filter(|[a, b]| a == b).count() as f64 / constrained.len() as f64;
        assert!(same > least && kept > 0.9, "{what}: {same} of {}, {kept} of the constrained", words.len());
    }
}

#[test]
fn fields_of_two_models_or_levels_are_not_compared_in_silence() {
    let desk = Desk::empty();
    let run = |scene: &str, more: &str| {
        let box_of_all = "--resolution 32 --occupancy 16 --box=-1,-1,-1,1,1,1";
        desk.good(&format!("uncertainty scene:{scene} --rays 1000 {box_of_all} {more}"));
    };
    run("ball", "--level 4 -o ball.oct");
    run("courtyard", "--level 4 -o courtyard.oct");
    desk.refused("compare ball.oct courtyard.oct", &["model of courtyard.oct", "--force"]);
    let said = desk.said("compare ball.oct courtyard.oct --force --points 1000");
    assert!(said.contains("warning: model of courtyard.oct"), "{said}");
    for scale in ["", "--scale data --noise 0.03"] {
        run("ball", &format!("--level 4 {scale} -o coarse.oct"));
        run("ball", &format!("--level 5 {scale} -o fine.oct"));
        let said = desk.said("compare coarse.oct fine.oct --points 1000");
        // In the paper's scale the prior is that of a cell's size.
        assert_eq!(said.contains("U of one field is on another scale"), scale.is_empty(), "{scale}: {said}");
    }
}
