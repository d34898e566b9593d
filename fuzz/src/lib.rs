//! What all fuzz targets do: make the file that the fuzzer's bytes describe, read it, and use what came of it.

#[path = "../../crates/cli/tests/untrusted/mod.rs"]
pub mod untrusted;

use std::path::PathBuf;
use std::sync::LazyLock;

pub use untrusted::Kind;
use untrusted::{forge, probe};

/// A folder in memory, where there is one.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = PathBuf::from("/dev/shm");
    let parent = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = parent.join(format!("octobayes-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the files to read");
    folder
});

/// Reads the file of a recipe. Being refused is a good end; panics and memory beyond libFuzzer's limits are not.
pub fn read(kind: Kind, recipe: &[u8]) {
    let path = FOLDER.join(kind.file_name());
    std::fs::write(&path, forge::file(kind, recipe)).expect("the file to read");
    let _ = probe::read(kind, &path);
}
