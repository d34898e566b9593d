//! Memory used by this process.

/// Peak resident set size of this process, in bytes, if the system reports it (Linux does).
#[must_use]
pub fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #[test]
    fn the_peak_covers_what_was_touched_and_never_falls() {
        let before = super::peak().unwrap();
        let touched = vec![1_u8; 64 << 20];
        let with = super::peak().unwrap();
        assert!(std::hint::black_box(touched).iter().all(|&b| b == 1));
        // Other tests of this process may have raised the peak before, so only a lower bound can be checked.
        assert!(with >= before && with >= 64 << 20);
    }
}
