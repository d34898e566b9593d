//! The unit of lengths.

use crate::options::{heading, numbers, parse_positive};
use glam::DVec3;

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

    /// The same by two points in scene units and their distance in metres: x,y,z,x,y,z,METRES
    #[arg(
        long,
        value_name = "A,B,METRES",
        value_parser = parse_known,
        allow_hyphen_values = true,
        help_heading = heading::INPUT,
    )]
    known: Option<f64>,
}

/// Metres of a scene unit, from two points and their distance.
fn parse_known(text: &str) -> Result<f64, String> {
    let [x, y, z, u, v, w, metres] = numbers::<7>(text)?;
    let distance = DVec3::new(x, y, z).distance(DVec3::new(u, v, w));
    parse_positive(&(metres / distance).to_string())
        .map_err(|_| "expected two different points and a distance above 0: x,y,z,x,y,z,METRES".into())
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
    pub fn unit(&self) -> Unit {
        let factor = self.metres_per_unit.or(self.known);
        Unit { factor: factor.unwrap_or(1.0), is_known: factor.is_some() }
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
