//! Writes the seeds of all targets: `cargo run --release --bin seeds` in `fuzz/`.

use octobayes_fuzz::Kind;
use octobayes_fuzz::untrusted::{forge, samples};

fn main() {
    for kind in Kind::ALL {
        let folder = format!("corpus/{kind:?}").to_lowercase();
        std::fs::create_dir_all(&folder).expect("a folder for the seeds");
        for (i, file) in samples::of(kind).iter().enumerate() {
            for (name, recipe) in [("whole", forge::raw(file)), ("parts", forge::recipe(kind, file))] {
                std::fs::write(format!("{folder}/seed-{i}-{name}"), recipe).expect("a seed");
            }
        }
    }
}
