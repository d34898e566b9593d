//! `uncertainty --coarser-levels`, from the command line.

mod program;

use octobayes::uncertainty::UncertaintyField;
use program::{good, run};

const RUN: &str = "uncertainty scene:courtyard --level 6 --rays 4000 --resolution 48 --occupancy 32";

#[test]
fn u_stays_and_rankings_read_all_levels() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    good(folder, &format!("{RUN} -o alone.oct"));
    good(folder, &format!("{RUN} --coarser-levels -o levels.oct"));
    let read = |name: &str| UncertaintyField::read(&folder.join(name)).unwrap();
    let (alone, levels) = (read("alone.oct"), read("levels.oct"));
    assert!(alone.deviations() == levels.deviations() && alone.coarser().is_empty());
    let of = |field: &UncertaintyField| field.coarser().iter().map(|f| f.lattice().level()).collect::<Vec<_>>();
    assert_eq!(of(&levels), [5, 4]);
    let info = good(folder, "info levels.oct");
    assert!(info.contains("coarser levels 5, 4, read by `u-spread` and `u-spread-per-root-ray`"), "{info}");
    assert!(!good(folder, "info alone.oct").contains("coarser levels"));
    let json = |name| serde_json::from_str::<serde_json::Value>(&good(folder, &format!("info {name} --json"))).unwrap();
    assert_eq!([json("alone.oct"), json("levels.oct")].map(|info| info["coarser_levels"].clone()), [0, 2]);

    // Of the uncertainty at a point nothing changes, of its ranking much.
    std::fs::write(folder.join("points.csv"), "0.3,-0.4,0.02\n").unwrap();
    let query = |name| good(folder, &format!("query {name} points.csv"));
    assert_eq!(query("alone.oct"), query("levels.oct"));
    for (average, same) in
        [("weighted-mean", true), ("at-expected", true), ("u-spread", false), ("u-spread-per-root-ray", false)]
    {
        let picture = |name: &str| {
            let camera = "--resolution 24 --frame 1";
            good(folder, &format!("render scene:courtyard {name} {camera} --ray-average {average} -o x.exr"));
            std::fs::read(folder.join("x.exr")).unwrap()
        };
        assert_eq!(picture("alone.oct") == picture("levels.oct"), same, "{average}");
    }

    good(folder, &format!("{RUN} --coarser-levels 2 --threads 1 -o again.oct"));
    assert!(read("again.oct") == levels);
}

#[test]
fn they_go_with_correlations_and_not_through_a_merge() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = RUN.replace("--level 6", "--level 4") + " --coarser-levels 1 --keep-sums";
    let read = |name: &str| UncertaintyField::read(&folder.join(name)).unwrap();
    let data = "--scale data --psnr 30 --covariance block";
    good(folder, &format!("{run} {data} --correlations 8 -o both.oct"));
    good(folder, &format!("{} {data} --correlations 8 -o one.oct", run.replace("--coarser-levels 1 ", "")));
    let (both, one) = (read("both.oct"), read("one.oct"));
    assert!(both.correlations().is_some() && both.correlations() == one.correlations());
    assert_eq!([both.coarser().len(), one.coarser().len()], [1, 0]);

    for seed in [1, 2] {
        good(folder, &format!("{run} --seed {seed} -o {seed}.oct"));
    }
    good(folder, "merge 1.oct 2.oct -o merged.oct");
    assert!(read("merged.oct").coarser().is_empty() && !read("1.oct").coarser().is_empty());
}

#[test]
fn what_they_need_is_said() {
    let folder = tempfile::tempdir().unwrap();
    for (more, code, expected) in [
        ("--coarser-levels 5", 2, "5 is not in 1..=4"),
        ("--coarser-levels 2 --checkpoint x.chk", 2, "cannot be used with"),
        ("--coarser-levels 2 --refine ray-count", 2, "coarser levels: expected a run of a number of rays"),
        ("--coarser-levels 2 --rays auto", 2, "coarser levels: expected a run of a number of rays"),
        ("--coarser-levels 2 --level 2", 2, "coarser levels: expected at most 1 below level 2, found 2"),
    ] {
        let mut base = RUN.to_owned();
        for option in ["--rays 4000", "--level 6"] {
            let name = option.split(' ').next().unwrap();
            if more.contains(&format!("{name} ")) {
                base = base.replace(&format!(" {option}"), "");
            }
        }
        let output = run(folder.path(), &format!("{base} -o x.oct {more}"));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(code) && said.contains(expected), "{more}: {said}");
    }
}
