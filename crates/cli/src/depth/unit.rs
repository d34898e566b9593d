//! The unit of lengths.

use glam::DVec3;
use octobayes::{Error, Result};

use crate::options::{heading, numbers, parse_positive};

/// What a scene unit is.
#[derive(clap::Args)]
pub struct UnitOptions {
    /// Metres of a scene unit [default: not known; all lengths are scene units]
    #[arg(
        long,
        value_name = "METRES",
        value_parser = parse_positive,
        conflicts_with = "known",
        help_heading = heading::INPUT,
    )]
    metres_per_unit: Option<f64>,

    /// The same by two points, x,y,z in scene units, and their distance in metres
    #[arg(long, num_args = 3, value_names = ["A", "B", "METRES"], allow_hyphen_values = true, help_heading = heading::INPUT)]
    known: Vec<String>,
}

/// What a scene unit is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Units of lengths that are written, for a scene unit.
    pub factor: f64,
    /// Whether they are metres.
    pub is_known: bool,
}

impl UnitOptions {
    /// The unit that the options state.
    pub fn unit(&self) -> Result<Unit> {
        if let Some(factor) = self.metres_per_unit {
            return Ok(Unit { factor, is_known: true });
        }
        if self.known.is_empty() {
            return Ok(Unit { factor: 1.0, is_known: false });
        }
        let [a, b, metres] = &self.known[..] else {
            return Err(Error::setting("--known", "two points and their distance, once", "more"));
        };
        let wrong = |what: &str, text: &str, found: String| Error::setting(format!("--known {what}"), text, found);
        let point = |what: &str, text: &str| {
            numbers::<3>(text.trim())
                .map(DVec3::from)
                .map_err(|found| wrong(what, "a point x,y,z in scene units", found))
        };
        let distance = point("A", a)?.distance(point("B", b)?);
        let metres = parse_positive(metres).map_err(|found| wrong("METRES", "their distance in metres", found))?;
        if distance == 0.0 {
            return Err(wrong("B", "another point than A", b.clone()));
        }
        Ok(Unit { factor: metres / distance, is_known: true })
    }
}

impl Unit {
    /// Its name, for people.
    pub fn name(self) -> &'static str {
        if self.is_known { "m" } else { "scene units" }
    }

    /// A length given in scene units, with two digits and the unit's name.
    pub fn length(self, value: f64) -> String {
        let value = self.factor * value;
        format!("{} {}", figure(value, value), self.name())
    }

    /// A point given in scene units, to a thousandth of its largest coordinate.
    pub fn place(self, x: DVec3) -> String {
        let x = self.factor * x;
        let [x, y, z] = x.to_array().map(|v| figure(v, 0.1 * x.abs().max_element()));
        format!("{x},{y},{z}")
    }
}

/// A number to two digits of what is `uncertain` of it.
pub fn figure(value: f64, uncertain: f64) -> String {
    let digits = if uncertain > 0.0 { (1.0 - uncertain.log10().floor()).clamp(0.0, 9.0) as usize } else { 3 };
    format!("{value:.digits$}")
}
