//! Pre-trained models, which the repository does not ship: `OCTOBAYES_DATA` names their folder.

mod models_on_data;
mod sight_on_data;
mod tolerance_on_data;

use std::path::PathBuf;

fn data(path: &str) -> PathBuf {
    let root = std::env::var_os("OCTOBAYES_DATA").expect("OCTOBAYES_DATA must name the folder of the data");
    PathBuf::from(root).join(path)
}
