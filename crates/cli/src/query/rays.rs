//! `query --ray`: depth along single rays, and how far it may be off.

use std::io::Write;
use std::path::Path;

use clap::Args;
use glam::DVec3;

use crate::options::{model_name, numbers};
use crate::progress::Bars;
use crate::streams;
use octobayes::Result;
use octobayes::geometry::Ray;
use octobayes::render::{Probe, RayAverage, VolumeRenderer, render_rays};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes_depth::DepthDeviation;
use octobayes_session::{OpenedModel, image_settings};

/// Rays to query, and the model that they pass through.
#[derive(Args)]
pub struct RayQuery {
    /// Ask about the depth along a ray: its origin and direction (of any length), scene units. May be given several
    /// times. OUT is CSV: origin, unit direction, opacity, median_depth (distance to the surface), expected_depth,
    /// depth_error (one standard deviation of depth, scene units; for fields of `--scale data`),
    /// log10_uncertainty (mean over what the ray hits) and, if the field is calibrated, depth_interval (half width)
    #[arg(
        long,
        value_name = "X,Y,Z,DX,DY,DZ",
        allow_hyphen_values = true,
        value_parser = parse_ray,
        requires = "model",
    )]
    pub ray: Vec<Ray>,

    /// The model that the rays of --ray pass through
    // Beside POINTS, which exclude --ray, clap waives `requires`.
    #[arg(long, value_name = "MODEL", value_parser = model_name(), requires = "ray", conflicts_with = "points")]
    pub model: Option<String>,

    /// Use the field even if it was computed for another model
    #[arg(long, requires = "model")]
    force: bool,
}

fn parse_ray(text: &str) -> std::result::Result<Ray, String> {
    let [x, y, z, dx, dy, dz] = numbers(text)?;
    let (origin, direction) = (DVec3::new(x, y, z), DVec3::new(dx, dy, dz));
    if direction.try_normalize().is_none() || !origin.is_finite() {
        return Err("expected a finite origin and a direction that is not zero".into());
    }
    Ok(Ray::new(origin, direction))
}

impl RayQuery {
    /// Writes a row for each ray. The inner error is that of `out`.
    pub fn answer(
        self,
        path: &Path,
        field: &UncertaintyField,
        out: &mut dyn Write,
        bars: &Bars,
    ) -> Result<std::io::Result<()>> {
        let name = self.model.unwrap_or_default();
        let opened = OpenedModel::of_field(field, path, &name, self.force, &mut streams::tell)?;
        let model = opened.volume()?;
        let settings = image_settings(field);
        let tracer = settings.tracer(model, 0.0, bars)?;
        let probes = [Probe { field, averages: &[RayAverage::WeightedMean] }];
        let view = render_rays(&tracer, &self.ray, &probes);
        // Fields in the paper's scale have no deviations of depth.
        let baked = BakedField::unbaked(field);
        let renderer = VolumeRenderer { tracer, differentiation: None };
        let deviation = DepthDeviation::new(&baked, None).ok();
        let deviation = deviation.map(|deviation| deviation.of_rays(&renderer, &self.ray, &view));
        let mut csv = csv::Writer::from_writer(out);
        let mut write = || -> csv::Result<()> {
            let mut head = vec!["x", "y", "z", "dx", "dy", "dz", "opacity", "median_depth", "expected_depth"];
            head.extend(["depth_error", "log10_uncertainty"]);
            head.extend(field.conformal().map(|_| "depth_interval"));
            csv.write_record(head)?;
            for (i, (ray, pixel)) in self.ray.iter().zip(&view.pixels).enumerate() {
                let mut row: Vec<String> =
                    ray.origin.to_array().iter().chain(&ray.direction.to_array()).map(f64::to_string).collect();
                // Where the ray meets nothing there is no depth.
                let hit = |value: f64| if pixel.opacity > 0.0 { known(value) } else { String::new() };
                let deviation = deviation.as_ref().map_or(f64::NAN, |of_rays| of_rays[i]);
                row.extend([pixel.opacity.to_string(), hit(pixel.median_depth), hit(pixel.expected_depth)]);
                row.extend([hit(deviation), known(view.log10_uncertainty[0][i])]);
                row.extend(field.conformal().map(|conformal| hit(conformal.factor * deviation)));
                csv.write_record(row)?;
            }
            csv.flush()?;
            Ok(())
        };
        Ok(write().map_err(streams::of_csv))
    }
}

/// A number, or nothing.
fn known(value: f64) -> String {
    if value.is_nan() { String::new() } else { value.to_string() }
}
