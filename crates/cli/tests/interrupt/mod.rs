//! Runs that are stopped on the way, and save their state. No clock decides on the moment: each run is stopped when a
//! file appears that it writes on the way.

use std::path::Path;
use std::process::{Child, Command, Output};
use std::time::Duration;

/// Sends a signal to a process.
pub fn send(signal: &str, child: &Child) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

/// Waits until `file` is there. Panics if the process ends first.
pub fn wait_for(file: &Path, child: &mut Child) {
    while !file.exists() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before {} was there", file.display());
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Stops a run by a signal once `file` is there. Returns what it printed.
pub fn stopped(file: &Path, mut child: Child, signal: &str) -> Output {
    wait_for(file, &mut child);
    send(signal, &child);
    child.wait_with_output().unwrap()
}
