//! `uncertainty --correlations`, from the command line.

mod program;

use octobayes::uncertainty::UncertaintyField;
use program::{good, run};

const RUN: &str = "uncertainty scene:courtyard --level 4 --rays 4000 --resolution 48 --occupancy 32";

#[test]
fn deviations_of_depth_grow_and_u_stays() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let data = format!("{RUN} --scale data --psnr 30 --covariance block --keep-sums");
    good(folder, &format!("{data} -o alone.oct"));
    good(folder, &format!("{data} --correlations 64 -o together.oct"));
    let read = |name: &str| UncertaintyField::read(&folder.join(name)).unwrap();
    let (alone, together) = (read("alone.oct"), read("together.oct"));
    assert_eq!(together.correlations().unwrap().draws(), 64);
    assert!(alone.deviations() == together.deviations());
    let info = good(folder, "info together.oct");
    assert!(info.contains("correlations 64 draws of all displacements together"), "{info}");
    assert!(!good(folder, "info alone.oct").contains("draws of all"));

    // Down onto the floor: s is the same, and Var is not.
    let deviation = |field: &str| -> f64 {
        let csv = good(folder, &format!("query {field} --ray 0.3,-0.4,2,0.05,0.02,-1 --model scene:courtyard"));
        let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        let column = rows[0].iter().position(|name| *name == "depth_error").unwrap();
        rows[1][column].parse().unwrap()
    };
    let (alone, together) = (deviation("alone.oct"), deviation("together.oct"));
    assert!(together > alone && together < 20.0 * alone, "{alone} and {together}");

    // The same again, on one thread.
    good(folder, &format!("{data} --correlations 64 --threads 1 -o again.oct"));
    assert!(read("again.oct").correlations() == read("together.oct").correlations());
}

#[test]
fn what_they_need_is_said() {
    let folder = tempfile::tempdir().unwrap();
    for (more, expected) in [
        ("", "--correlations: expected --scale data"),
        ("--scale data --psnr 30 --refine ray-count", "expected leaves as fine as the level, found --refine ray-count"),
        (
            "--scale data --psnr 30 --refine density",
            "expected leaves as fine as the level wherever rays moved a vertex",
        ),
        ("--scale data --psnr 30 --rays auto", "expected a number of rays"),
    ] {
        let base = RUN.replace(if more.contains("auto") { " --rays 4000" } else { "unchanged" }, "");
        let output = run(folder.path(), format!("{base} --correlations -o x.oct {more}").trim_end());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(2) && said.contains(expected), "{more}: {said}");
    }
}
