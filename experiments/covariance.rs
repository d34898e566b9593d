//! Question: which scalar, read off the Hessian, ranks the depth error best, and does it depend on the level?
//!
//! Lego, twice: the MLP (102,400 rays) and the Plenoptic PNG of type 1 (409,600 rays), levels 6 to 9, octrees at the default tolerance.
//! AUSE of the median depth's absolute error over the 40 test views at every fourth pixel along x and y. Uses the command line
//! next to this program (`cargo build --release` first). Prints the tables of `experiments/covariance.md`.

use std::path::{Path, PathBuf};
use std::process::Command;

use octobayes::{Error, Result};

const COVARIANCES: [&str; 3] = ["diagonal", "trace", "block"];

fn main() -> Result<()> {
    let data = PathBuf::from(std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA names the data folder"));
    let at = |path: &str| data.join(path).to_string_lossy().into_owned();
    let train = at("nerf-mlp-pretrained/cameras/lego_train.json");
    let test = at("nerf-lego-400/transforms_test.json");
    let depth = at("nerf-lego-400/test");
    let ppng = at("ppng-pretrained/NeRFSynthetic/ppng_1/lego.ppng");
    let mlp = at("nerf-mlp-pretrained/lego.safetensors");
    let out = Path::new("target/experiments");
    std::fs::create_dir_all(out).map_err(Error::io(out, "cannot create the folder"))?;
    for (name, model, extra, rays) in
        [("Plenoptic PNG type 1", &ppng, vec!["--coordinates", "blender"], "409600"), ("MLP", &mlp, vec![], "102400")]
    {
        println!("\n### {name}, {rays} rays\n\n| level | vertices | {} |", COVARIANCES.join(" | "));
        println!("|---|---|---|---|---|---|");
        for level in 6..=9 {
            let field = out.join(format!("covariance_{level}.oct")).to_string_lossy().into_owned();
            let level = level.to_string();
            let mut arguments = vec!["uncertainty", model, "--cameras", &train, "--resolution", "400", "--json"];
            arguments.extend(["--level", &level, "--rays", rays, "-o", &field]);
            arguments.extend(&extra);
            let run = octobayes(&arguments)?;
            let mut arguments = vec!["evaluate", model, &field, "--cameras", &test, "--depth", &depth];
            let readings = COVARIANCES.join(",");
            arguments.extend(["--depth-encoding", "8,-8", "--stride", "4", "--covariance", &readings, "--json"]);
            arguments.extend(&extra);
            let scores = octobayes(&arguments)?;
            // One field, read in the order asked for.
            let ause = |i: usize| scores["readings"][i]["ause_pooled"]["mae"].as_f64();
            let cells: Vec<String> = (0..4).map(|i| ause(i).map_or("?".into(), |v| format!("{v:.3}"))).collect();
            println!("| {level} | {} | {} |", run["summary"]["vertices"], cells.join(" | "));
        }
    }
    Ok(())
}

/// Runs the command line; its JSON.
fn octobayes(arguments: &[&str]) -> Result<serde_json::Value> {
    let program = std::env::current_exe().map_err(Error::io(Path::new("this program"), "cannot find"))?;
    let binary = program.parent().and_then(Path::parent).unwrap_or(Path::new(".")).join("octobayes");
    let output = Command::new(&binary).args(arguments).output().map_err(Error::io(&binary, "cannot run"))?;
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout).expect("--json prints JSON"))
}
