//! `measure`: the distance of two points on surfaces, with its deviation.

use std::path::PathBuf;

use glam::DVec3;
use serde_json::json;

use super::depth::{Look, SceneOptions, Unit, UnitOptions, figure};
use super::files::CommandFiles;
use super::options::{ModelArgument, heading, numbers};
use super::progress::Bars;
use octobayes::{Error, Result};
use octobayes_depth::{Length, NINETY, SurfacePoint, Trust};

/// Measure the distance of two points on surfaces, with its deviation
///
/// A and B are points x,y,z: in metres, as in points.ply of `depth`, if an option states the unit, else in scene units.
/// Each is moved to the surface that a training camera sees there, along the
/// view in which its depth has the smallest deviation; a point in the air, or inside something, is refused with the
/// nearest surface. The deviation joins those of both depths, as far as they lie along the line, with their correlation
/// through the field's vertices that both share, and the width of a pixel.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes measure lego.safetensors depth/field.oct 0.1,0.3,0.2 -0.4,0.1,0.2\n  \
    octobayes measure scene.ply depth/field.oct 1.2,0.3,2 0.1,0.4,2.2 --cameras cameras.json --metres-per-unit 0.5")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// The field of `depth` (or of `uncertainty --for depth`; without it, it is computed first), and the points
    #[arg(value_names = ["[FIELD.oct] A", "B"], num_args = 2..=3, required = true)]
    places: Vec<String>,

    #[command(flatten)]
    scene: SceneOptions,

    #[command(flatten)]
    unit: UnitOptions,

    /// Print one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        let (field, points) = match &self.places[..] {
            [field, a, b] => (Some(PathBuf::from(field)), [a, b]),
            [a, b] => (None, [a, b]),
            _ => unreachable!("two or three by their number"),
        };
        let point = |text: &String| {
            let wrong = |found| Error::setting("point", "x,y,z, such as 1.2,0.3,2", found);
            numbers::<3>(text.trim()).map(DVec3::from).map_err(wrong)
        };
        let unit = self.unit.unit();
        let points = [point(points[0])? / unit.factor, point(points[1])? / unit.factor];
        let files = self.scene.files(&self.model.model, field.as_deref())?;
        files.check()?;
        let check = |_: &[_], files: CommandFiles| files.check();
        let scene = self.scene.open(&self.model.model, field.as_deref(), &files, check, None, bars)?;
        // A picture of 31 pixels a side for a few views of each point.
        scene.look(20_000, bars, |look| self.measure(look, points, unit))
    }

    fn measure(&self, look: &Look, points: [DVec3; 2], unit: Unit) -> Result<()> {
        let names = ["A", "B"];
        let name = |camera: usize| octobayes::error::printable(&look.frames[camera].name).to_string();
        let snap = |k: usize| {
            let (place, length) = (|x: DVec3| unit.place(x), |v: f64| unit.length(v));
            look.surveyor.snap(points[k])?.surface(names[k], points[k], place, length, name)
        };
        let ends = [snap(0)?, snap(1)?];
        let Length { length, deviation, correlation } = Length::between(&ends[0], &ends[1], look.field)?;
        let [length, deviation] = [length, deviation].map(|v| unit.factor * v);
        if self.json {
            let point = |end: &SurfacePoint| {
                json!({
                    "position": (unit.factor * end.position).to_array(), "view": name(end.camera), "sigma": unit.factor * end.deviation,
                    "trust": end.trust.name(),
                })
            };
            return say!(
                "{}",
                json!({
                    "length": length, "sigma": deviation, "interval_90": [length - NINETY * deviation, length + NINETY * deviation], "unit": unit.name(),
                    "correlation": correlation, "points": ends.map(|end| point(&end)),
                })
            );
        }
        for (k, end) in ends.iter().enumerate() {
            let moved = end.position.distance(points[k]);
            announce!(
                "note: {} moved {} to the surface, {} ± {} along the view of {}",
                names[k],
                unit.length(moved),
                unit.place(end.position),
                unit.length(NINETY * end.deviation),
                name(end.camera)
            );
            if end.trust != Trust::Trusted {
                announce!("warning: the depth of {} cannot be trusted: {}", names[k], end.trust);
            }
        }
        let wide = NINETY * deviation;
        say!("{} {} ± {} (90 %)", figure(length, wide), unit.name(), figure(wide, wide))
    }
}
