//! Time of the wall and of processors.

use std::time::Instant;

use serde::{Deserialize, Serialize};

/// Time that something took.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Time {
    /// Of all threads of this process, seconds: what counts where others use the machine too. 0 where the system does
    /// not say.
    pub cpu: f64,
    /// Seconds.
    pub wall: f64,
}

impl std::ops::Add for Time {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { cpu: self.cpu + other.cpu, wall: self.wall + other.wall }
    }
}

/// Time since a moment.
pub struct Clock {
    start: Instant,
    cpu: f64,
}

impl Clock {
    #[must_use]
    pub fn start() -> Self {
        Self { start: Instant::now(), cpu: cpu() }
    }

    #[must_use]
    pub fn elapsed(&self) -> Time {
        Time { cpu: cpu() - self.cpu, wall: self.start.elapsed().as_secs_f64() }
    }
}

/// Processor time of this process and of its finished children so far, seconds (Linux: hundredths).
fn cpu() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Behind the name, which may hold spaces: state is field 3; user and system time are fields 14 and 15, those of
    // children 16 and 17.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i - 3).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (14..=17).map(ticks).sum::<f64>() / 100.0
}

/// Today (UTC), as `2026-11-22`.
#[must_use]
pub fn today() -> String {
    let now = humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string();
    now.chars().take(10).collect()
}
