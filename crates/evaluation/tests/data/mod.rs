//! On splats that the repository does not ship: `OCTOBAYES_DATA` names their folder.

mod splat_judge;

use std::path::PathBuf;

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}
