//! Progress for stderr that is no terminal: a line every ten seconds, and none for work that takes less.
//!
//! The time that is left shows once enough is done to estimate it.

use std::time::{Duration, Instant};

/// Time between lines.
const EVERY: Duration = Duration::from_secs(10);
/// A stage has no line before.
const SHORTEST: Duration = Duration::from_secs(2);
/// Share of a stage from which its time is known.
const TELLING: f64 = 0.02;

/// Time left of a stage whose `share` took `elapsed`; `None` before that can be known.
pub fn left(share: f64, elapsed: Duration) -> Option<Duration> {
    let is_known = share >= TELLING && elapsed >= SHORTEST;
    is_known.then(|| elapsed.mul_f64((1.0 / share - 1.0).max(0.0)))
}

/// The stage under way, and when it was last reported.
pub struct Lines {
    stage: String,
    total: u64,
    done: u64,
    begun: Instant,
    printed: Instant,
    message: String,
}

impl Lines {
    /// Work begins at `now`.
    pub fn new(now: Instant) -> Self {
        Self { stage: String::new(), total: 0, done: 0, begun: now, printed: now, message: String::new() }
    }

    /// A stage of `total` units begins.
    pub fn begin(&mut self, stage: &str, total: u64, now: Instant) {
        *self = Self { stage: stage.into(), total, begun: now, ..Self::new(self.printed) };
    }

    /// Text about the stage, for the next line.
    pub fn message(&mut self, text: String) {
        self.message = text;
    }

    /// Another line was printed.
    pub fn printed(&mut self, now: Instant) {
        self.printed = now;
    }

    /// `units` more are done. Returns the line to print, if it is time.
    pub fn advance(&mut self, units: u64, now: Instant) -> Option<String> {
        self.done = self.done.saturating_add(units);
        let elapsed = now.duration_since(self.begun);
        let is_under_way = self.done > 0 && self.done < self.total && elapsed >= SHORTEST;
        if now.duration_since(self.printed) < EVERY || !is_under_way {
            return None;
        }
        self.printed = now;
        let share = self.done as f64 / self.total as f64;
        let left = left(share, elapsed)
            .map_or(String::new(), |left| format!(", about {:.0} s left", left.as_secs_f64().ceil()));
        let message = if self.message.is_empty() { String::new() } else { format!("; {}", self.message) };
        let Self { stage, done, total, .. } = self;
        Some(format!("{stage}: {done} of {total} ({:.0} %){left}{message}", 100.0 * share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_comes_every_ten_seconds_and_none_before() {
        let start = Instant::now();
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        let mut lines = Lines::new(start);
        lines.begin("rays", 400, at(4));
        assert_eq!(lines.advance(50, at(9)), None);
        // 100 of 400 units in 6 seconds.
        assert_eq!(lines.advance(50, at(10)).unwrap(), "rays: 100 of 400 (25 %), about 18 s left");
        assert_eq!(lines.advance(50, at(19)), None);
        lines.message("step 7".into());
        assert!(lines.advance(200, at(20)).unwrap().ends_with("(88 %), about 3 s left; step 7"));
        assert_eq!(lines.advance(50, at(31)), None, "all is done");
        // Short stages share the ten seconds, and a stage without progress prints nothing.
        lines.begin("rows", 10, at(28));
        assert_eq!(lines.advance(0, at(31)), None);
        assert_eq!(lines.advance(5, at(32)).unwrap(), "rows: 5 of 10 (50 %), about 4 s left");
        // A stage that has hardly begun has no line, and of too little no time follows.
        lines.begin("occupancy", 4096, at(50));
        assert_eq!(lines.advance(1, at(51)), None);
        assert_eq!(lines.advance(39, at(52)).unwrap(), "occupancy: 40 of 4096 (1 %)");
        // A line of the work's own counts, too.
        lines.printed(at(40));
        assert_eq!(lines.advance(1, at(49)), None);
    }
}
