//! Memory used by this process.

/// Present resident set size of this process, in bytes, if the system reports it (Linux does).
#[must_use]
pub fn resident() -> Option<u64> {
    entry("/proc/self/status", "VmRSS:")
}

/// The value of a line such as `VmRSS:   1234 kB` of a file of the system, bytes.
#[must_use]
pub fn entry(file: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
