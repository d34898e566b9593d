//! Numbers as people write them: `1M`, `4e5`, `250k`, `1_000_000`; times: `90s`, `5min`, `1h30m`.

use std::ops::{Bound, RangeBounds};
use std::time::Duration;

/// A parser of whole numbers in `range`, for clap.
///
/// Takes `k`, `M` and `G` (thousands, millions, billions, in either case), an exponent, and `_` between digits. The
/// value must be whole: `1.5k` is, `1.5` is not.
pub fn count<T: TryFrom<u64>>(
    range: impl RangeBounds<u64> + Clone + Send + Sync + 'static,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let value = whole(text).filter(|value| range.contains(value));
        value.and_then(|value| T::try_from(value).ok()).ok_or_else(|| expected_count(&range))
    }
}

/// How many rays a run draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RayCount {
    /// So many, of chosen pixels.
    Drawn(u64),
    /// One through every training pixel.
    All,
}

impl RayCount {
    /// Parses a number of rays, or `all`, for clap.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => count(1..=MAX_COUNT)(text).map(Self::Drawn).map_err(|expected| expected + ", or all"),
        }
    }
}

impl std::fmt::Display for RayCount {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Drawn(rays) => rays.fmt(f),
            Self::All => f.write_str("all"),
        }
    }
}

/// Numbers up to this need no other spelling.
const LONGEST_PLAIN: u64 = 2000;

/// What [`count`] takes, in words.
fn expected_count(range: &impl RangeBounds<u64>) -> String {
    let low = match range.start_bound() {
        Bound::Included(&low) => low,
        Bound::Excluded(&low) => low + 1,
        Bound::Unbounded => 0,
    };
    let high = match range.end_bound() {
        Bound::Included(&high) => format!("from {low} to {high}"),
        Bound::Excluded(&high) => format!("from {low} to {}", high - 1),
        Bound::Unbounded => format!("of {low} or more"),
    };
    let is_short =
        matches!(range.end_bound(), Bound::Included(&high) | Bound::Excluded(&high) if high <= LONGEST_PLAIN);
    let such_as = if is_short { "" } else { ", such as 20000, 20_000, 20k or 2e4" };
    format!("expected a whole number {high}{such_as}")
}

/// The whole number that `text` stands for, without rounding.
fn whole(text: &str) -> Option<u64> {
    let text = text.replace('_', "").to_lowercase();
    if let Ok(number) = text.parse() {
        return Some(number);
    }
    let suffixes = [("k", 3), ("m", 6), ("g", 9)].into_iter();
    let mut in_words = suffixes.filter_map(|(suffix, power)| Some((text.strip_suffix(suffix)?.trim_end(), power)));
    let number = in_words.next().map_or(text.clone(), |(number, power)| format!("{number}e{power}"));
    // All of these are exact.
    let value = number.parse().ok().filter(|value: &f64| value.fract() == 0.0 && (0.0..=9e15).contains(value));
    value.map(|value| value as u64)
}

/// Largest number in options that cost time and not memory, such as rays: sums of that many stay exact.
pub const MAX_COUNT: u64 = 1_000_000_000_000_000;
/// Largest number in options that cost memory, such as points.
pub const MAX_KEPT_COUNT: u64 = 100_000_000;
/// Longest time, ten years, far from where clocks overflow.
const LONGEST: Duration = Duration::from_secs(10 * 365 * 86_400);

/// What [`parse_time`] takes, in words.
const TIMES: &str = "such as 90s, 5min, 1.5h or 1h30m; a number alone is seconds";

/// A time above 0.
pub fn parse_time(text: &str) -> Result<Duration, String> {
    let seconds = text.trim().parse().ok().and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    let time = seconds.or_else(|| humantime::parse_duration(text).ok());
    let sound = time.filter(|time| !time.is_zero() && *time <= LONGEST);
    sound.ok_or_else(|| format!("expected a time above 0, {TIMES}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_as_people_write_them() {
        let parse = count::<u64>(1..);
        let cases = [
            ("7", 7),
            ("1M", 1_000_000),
            ("4e5", 400_000),
            ("4E+5", 400_000),
            ("250k", 250_000),
            ("250 K", 250_000),
            ("1_000_000", 1_000_000),
            ("100_000", 100_000),
            ("4.096M", 4_096_000),
            ("1.005k", 1005),
            ("1.5e3", 1500),
            ("2g", 2_000_000_000),
            ("1.0", 1),
            ("18446744073709551615", u64::MAX),
        ];
        for (text, value) in cases {
            assert_eq!(parse(text), Ok(value), "{text}");
        }
        let refused = [
            "",
            "0",
            "-1",
            "1.5",
            "1.0005k",
            "1e-3",
            "e5",
            "k",
            "1kk",
            "1 000",
            "nan",
            "inf",
            "1e400",
            "0x10",
            "١",
            "1M rays",
            "18446744073709551616",
        ];
        for text in refused {
            let error = parse(text).expect_err(text);
            assert!(error.contains("of 1 or more") && error.contains("20k"), "{error}");
        }
        assert_eq!(count::<u32>(1..=1000)("1k"), Ok(1000));
        assert!(count::<u32>(1..=1000)("1001").unwrap_err().contains("from 1 to 1000"));
        assert!(count::<u8>(..)("300").is_err() && count::<usize>(..)("0") == Ok(0));
    }

    #[test]
    fn times_are_read_as_people_write_them() {
        let cases = [
            ("90s", 90.0),
            ("5min", 300.0),
            ("3m", 180.0),
            ("1.5h", 5400.0),
            ("1h30m", 5400.0),
            ("1h 30 min", 5400.0),
            ("2 days", 172_800.0),
            ("20", 20.0),
            ("0.25", 0.25),
        ];
        for (text, seconds) in cases {
            assert_eq!(parse_time(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "-1s", "m", "3x", "1h30", "1e30h", "99999999999999999999h", "3651d", "1..2s", "s1", "5 é"] {
            assert!(parse_time(text).unwrap_err().contains("1h30m"), "{text}");
        }
        assert!(parse_time("0").is_err());
    }
}
