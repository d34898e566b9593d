//! The peak of this process, and memory that it can still have.

use std::path::{Path, PathBuf};

use octobayes::io::memory::entry;
use octobayes::uncertainty::{BakedField, UncertaintyField};

/// Free bytes if the system does not report them.
const DEFAULT_ROOM: u64 = 4 << 30;

/// A number of bytes, human-readable.
#[must_use]
pub fn bytes(n: usize) -> String {
    let n = n as f64;
    match n {
        n if n < 1e3 => format!("{n} B"),
        n if n < 1e6 => format!("{:.1} kB", n / 1e3),
        n if n < 1e9 => format!("{:.2} MB", n / 1e6),
        n => format!("{:.2} GB", n / 1e9),
    }
}

/// Peak resident set size of this process, in bytes, if the system reports it (Linux does).
#[must_use]
pub fn peak() -> Option<u64> {
    entry("/proc/self/status", "VmHWM:")
}

/// Bytes that this process can still take: what the machine has free, or what the nearest control group allows, if
/// that is less. `None` if the system does not report it (Linux does).
pub fn available() -> Option<u64> {
    let machine = entry("/proc/meminfo", "MemAvailable:")?;
    let groups = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let own = groups.lines().find_map(|line| line.strip_prefix("0::/")).unwrap_or_default();
    let least = group_and_parents(Path::new("/sys/fs/cgroup"), own).filter_map(|group| left_in(&group));
    Some(least.fold(machine, u64::min))
}

/// The field with the values of its leaves side by side, if a quarter of what is free has room for them, and so many
/// questions are to come that gathering them pays.
#[must_use]
pub fn baked(field: &UncertaintyField, questions: u64) -> BakedField<'_> {
    if questions < field.deviations().len() as u64 {
        return BakedField::unbaked(field);
    }
    BakedField::within((available().unwrap_or(DEFAULT_ROOM) / 4) as usize, field)
}

/// The folders of a control group (version 2) and of the groups around it.
fn group_and_parents(root: &Path, own: &str) -> impl Iterator<Item = PathBuf> {
    let mut group = root.join(own);
    let root = root.to_path_buf();
    std::iter::from_fn(move || {
        let here = group.starts_with(&root).then(|| group.clone())?;
        group.pop();
        Some(here)
    })
}

/// Bytes that a control group still allows; `None` without a limit. Files that it holds in memory can be dropped.
fn left_in(group: &Path) -> Option<u64> {
    let read = |name| std::fs::read_to_string(group.join(name)).ok();
    let number = |name| read(name)?.trim().parse::<u64>().ok();
    let limit = number("memory.max")?;
    let statistics = read("memory.stat").unwrap_or_default();
    let files = statistics.lines().find_map(|line| line.strip_prefix("inactive_file "));
    let files = files.and_then(|bytes| bytes.trim().parse().ok()).unwrap_or(0);
    Some(limit.saturating_sub(number("memory.current")?.saturating_sub(files)))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use octobayes::io::memory::resident;

    #[test]
    fn the_peak_covers_what_was_touched_and_never_falls() {
        let before = peak().unwrap();
        let touched = vec![1_u8; 64 << 20];
        let (with, now) = (peak().unwrap(), resident().unwrap());
        assert!(std::hint::black_box(touched).iter().all(|&b| b == 1));
        // Other tests of this process may have raised the peak before, so only a lower bound can be checked.
        assert!(with >= before && with >= 64 << 20 && now >= 64 << 20);
        let machine = entry("/proc/meminfo", "MemTotal:").unwrap();
        assert!((1..=machine).contains(&available().unwrap()));
    }

    #[test]
    fn the_nearest_limit_of_a_control_group_counts_without_its_files() {
        let root = tempfile::tempdir().unwrap();
        let inner = root.path().join("outer/inner");
        std::fs::create_dir_all(&inner).unwrap();
        let outer = root.path().join("outer");
        let write = |folder: &Path, name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
        write(&inner, "memory.max", "max\n");
        write(&outer, "memory.max", "1000000\n");
        write(&outer, "memory.current", "700000\n");
        write(&outer, "memory.stat", "anon 500000\ninactive_file 200000\n");
        let found: Vec<_> = group_and_parents(root.path(), "outer/inner").map(|group| left_in(&group)).collect();
        assert_eq!(found, [None, Some(500_000), None]);
    }
}
