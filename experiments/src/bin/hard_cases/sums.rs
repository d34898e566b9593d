//! Sums: what order, precision and compensation make of ten million contributions over eighteen decades.

use octobayes::Result;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use common::table::Table;

/// Contributions.
const COUNT: usize = 10_000_000;
/// Bits behind the point of a fixed-point sum: 2⁻⁸⁰ = 8e-25 a unit, ±1.4e14 at most.
const FRACTION: i32 = 80;

/// Neumaier 1974: the rounding of every addition is kept and added at the end.
#[derive(Clone, Copy, Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, v: f64) {
        let t = self.sum + v;
        self.lost += if self.sum.abs() >= v.abs() { (self.sum - t) + v } else { (v - t) + self.sum };
        self.sum = t;
    }
}

fn fixed(v: f64) -> i128 {
    (v * f64::from(FRACTION).exp2()).round() as i128
}

/// Ways to add up.
const METHODS: [&str; 4] = ["f32", "f64", "f64, compensated (Neumaier)", "fixed point, i128"];

/// The sum over `parts` of the contributions, each part by itself, parts in order.
fn sum(method: usize, values: &[f64], parts: usize) -> f64 {
    let parts = values.chunks(values.len().div_ceil(parts));
    match method {
        0 => f64::from(parts.map(|part| part.iter().fold(0.0_f32, |s, &v| s + v as f32)).fold(0.0_f32, |s, v| s + v)),
        1 => parts.map(|part| part.iter().fold(0.0, |s, &v| s + v)).fold(0.0, |s, v| s + v),
        2 => {
            let mut all = Compensated::default();
            for part in parts {
                let mut one = Compensated::default();
                part.iter().for_each(|&v| one.add(v));
                all.add(one.sum);
                all.lost += one.lost;
            }
            all.sum + all.lost
        }
        _ => {
            let units = parts.map(|part| part.iter().map(|&v| fixed(v)).sum::<i128>()).sum::<i128>();
            units as f64 * f64::from(-FRACTION).exp2()
        }
    }
}

/// The exact sum, rounded once. Contributions are whole multiples of 2⁻¹¹⁵ here, which two words hold.
fn exact(values: &[f64]) -> f64 {
    // High and low parts of every value: above 2⁻⁶⁰, and what is left times 2⁶⁰; both are exact.
    let (mut high, mut low) = (0_i128, 0_i128);
    let unit = f64::from(60).exp2();
    for &v in values {
        let whole = (v * unit).floor();
        high += whole as i128;
        low += ((v * unit - whole) * unit) as i128;
    }
    let carry = low >> 60;
    ((high + carry) as f64 + (low & ((1 << 60) - 1)) as f64 / unit) / unit
}

/// The tables.
pub fn sums() -> Result<(String, String)> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    // Whole multiples of 2⁻¹¹⁵: the last bits of the smallest are cut.
    let cut = |v: f64| (v * f64::from(115).exp2()).round() * f64::from(-115).exp2();
    let spread: Vec<f64> = (0..COUNT).map(|_| cut(10_f64.powf(rng.random_range(-12.0..6.0)))).collect();
    let sorted = |increasing: bool| {
        let mut values = spread.clone();
        values.sort_unstable_by(f64::total_cmp);
        if !increasing {
            values.reverse();
        }
        values
    };
    let mut table = Table::new(&[
        "relative error",
        "as they come",
        "increasing",
        "decreasing",
        "2 parts",
        "64 parts",
        "other bits with 2 or 64 parts",
        "hardly seen",
    ]);
    let (increasing, decreasing) = (sorted(true), sorted(false));
    let truth = exact(&spread);
    assert_eq!(truth.to_bits(), exact(&increasing).to_bits(), "an exact sum knows no order");
    // What a vertex that only small contributions reach makes of each.
    let small: Vec<f64> = (0..COUNT).map(|_| cut(10_f64.powf(rng.random_range(-12.0..-6.0)))).collect();
    let small_truth = exact(&small);
    for (method, name) in METHODS.iter().enumerate() {
        let error = |values: &[f64], parts| format!("{:.1e}", (sum(method, values, parts) / truth - 1.0).abs());
        let plain = sum(method, &spread, 1);
        let differs = [2, 64].iter().any(|&parts| sum(method, &spread, parts).to_bits() != plain.to_bits());
        table.row(&[
            (*name).to_string(),
            error(&spread, 1),
            error(&increasing, 1),
            error(&decreasing, 1),
            error(&spread, 2),
            error(&spread, 64),
            if differs { "yes" } else { "no" }.into(),
            format!("{:.1e}", (sum(method, &small, 1) / small_truth - 1.0).abs()),
        ]);
    }
    let words = format!(
        "{COUNT} squares, evenly spread over the decades from 1e-12 to 1e6 (*hardly seen*: to 1e-6), seed 0; errors \
         against the exact sum. Parts: summed each by itself, then together."
    );
    Ok((words, table.text().into()))
}
