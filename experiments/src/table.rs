//! Tables in Markdown, and numbers with their spread.

/// A table in Markdown.
pub struct Table(String);

impl Table {
    #[must_use]
    pub fn new(head: &[&str]) -> Self {
        let mut out = Self(String::new());
        out.row(head);
        out.row(&vec!["---"; head.len()]);
        out
    }

    pub fn row<S: AsRef<str>>(&mut self, cells: &[S]) {
        let cells: Vec<&str> = cells.iter().map(AsRef::as_ref).collect();
        self.0 += &format!("| {} |\n", cells.join(" | "));
    }

    #[must_use]
    pub fn text(&self) -> &str {
        &self.0
    }
}

/// Mean of some values.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation of some values as a sample; 0 for one.
#[must_use]
pub fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / (values.len().max(2) - 1) as f64).sqrt()
}

/// Mean ± standard deviation over seeds, with so many digits behind the point; the mean alone if there is one seed.
#[must_use]
pub fn spread(values: &[f64], digits: usize) -> String {
    let mean = format!("{:.digits$}", mean(values));
    if values.len() < 2 { mean } else { format!("{mean} ± {:.digits$}", deviation(values)) }
}

/// The same with two digits of the mean and one of the deviation, for values of all sizes.
#[must_use]
pub fn spread_e(values: &[f64]) -> String {
    let mean = format!("{:.1e}", mean(values));
    if values.len() < 2 { mean } else { format!("{mean} ± {:.0e}", deviation(values)) }
}

/// A whole number with commas, rounded.
#[must_use]
pub fn whole(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap_or_default()).collect();
    format!("{}{}", if value < 0.0 { "-" } else { "" }, groups.join(","))
}

/// A whole number ± standard deviation over seeds.
#[must_use]
pub fn whole_spread(values: &[f64]) -> String {
    if deviation(values) < 0.5 {
        return whole(mean(values));
    }
    format!("{} ± {}", whole(mean(values)), whole(deviation(values)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_carry_their_spread() {
        assert_eq!(spread(&[1.0, 2.0, 3.0], 2), "2.00 ± 1.00");
        assert_eq!(spread(&[1.5], 1), "1.5");
        assert_eq!(spread_e(&[1e-3, 3e-3]), "2.0e-3 ± 1e-3");
        assert_eq!(whole(1_234_567.4), "1,234,567");
        assert_eq!(whole(12.0), "12");
        assert_eq!(whole_spread(&[1000.0, 1000.0]), "1,000");
        assert_eq!(whole_spread(&[1000.0, 3000.0]), "2,000 ± 1,414");
    }

    #[test]
    fn tables_are_markdown() {
        let mut table = Table::new(&["a", "b"]);
        table.row(&[String::from("1"), String::from("2")]);
        assert_eq!(table.text(), "| a | b |\n| --- | --- |\n| 1 | 2 |\n");
    }
}
