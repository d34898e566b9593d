//! U on the surfaces that cameras see, camera by camera and region by region, as a table.

use std::collections::BTreeMap;
use std::path::Path;

use super::points::Surfaces;
use octobayes::io::{AtomicFile, cell};
use octobayes::metrics::quantile;
use octobayes::uncertainty::{Observability, UncertaintyField};
use octobayes::{Error, Result};

/// Shares whose quantiles are reported.
const SHARES: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];
/// Regions along each axis of the field's domain.
const REGIONS: f64 = 4.0;

/// Surface points that share a row.
#[derive(Default)]
struct Group {
    sigma: Vec<f64>,
    unseen: u64,
    outside: u64,
}

/// Writes one row for each camera, one for each region of the domain that has surfaces, and one for all.
///
/// # Errors
/// If the file cannot be written.
pub fn write_report(path: &Path, surfaces: &Surfaces, names: &[String], field: &UncertaintyField) -> Result<()> {
    let mut cameras: Vec<Group> = names.iter().map(|_| Group::default()).collect();
    let mut regions: BTreeMap<[u8; 3], Group> = BTreeMap::new();
    let mut all = Group::default();
    let answers = field.answers(&surfaces.positions);
    // Without ray coverage it is unknown what was seen.
    let knows_coverage = answers.iter().any(|found| found.ray_coverage.is_some());
    for (i, found) in answers.iter().enumerate() {
        let x = surfaces.positions[i];
        let (is_unseen, inside) = (found.observability == Some(Observability::Unseen), found.estimate.inside);
        let add = |group: &mut Group| {
            group.sigma.push(found.estimate.uncertainty);
            group.unseen += u64::from(is_unseen && inside);
            group.outside += u64::from(!inside);
        };
        add(&mut cameras[surfaces.cameras[i] as usize]);
        add(&mut all);
        if let Some(unit) = field.lattice().domain().to_unit(x) {
            let region = unit.to_array().map(|u| (REGIONS * u).min(REGIONS - 1.0) as u8);
            add(regions.entry(region).or_default());
        }
    }

    let failed = |e: csv::Error| Error::io(path, "cannot write")(e.into());
    let mut table = csv::Writer::from_writer(AtomicFile::create(path)?);
    let quantiles = SHARES.map(|share| format!("sigma_q{:02.0}", 100.0 * share));
    let head = ["kind", "name", "pixels", "surface_points", "never_seen", "outside"].map(String::from);
    table.write_record(head.iter().chain(&quantiles)).map_err(failed)?;
    let mut row = |kind: &str, name: &str, pixels: Option<u64>, mut group: Group| {
        group.sigma.sort_unstable_by(f64::total_cmp);
        let n = group.sigma.len();
        let share = |part: u64| if n > 0 { format!("{:.6}", part as f64 / n as f64) } else { String::new() };
        let unseen = if knows_coverage { share(group.unseen) } else { String::new() };
        let number = |v: f64| if v.is_nan() { String::new() } else { format!("{v:e}") };
        let fixed = [
            kind.to_string(),
            cell(name.to_string()),
            pixels.map_or_else(String::new, |n| n.to_string()),
            n.to_string(),
            unseen,
            share(group.outside),
        ];
        let quantiles = SHARES.map(|share| number(quantile(&group.sigma, share)));
        table.write_record(fixed.iter().chain(&quantiles)).map_err(failed)
    };
    row("all", "", Some(surfaces.pixels.iter().sum()), all)?;
    for ((name, pixels), group) in names.iter().zip(&surfaces.pixels).zip(cameras) {
        row("camera", name, Some(*pixels), group)?;
    }
    for ([x, y, z], group) in regions {
        row("region", &format!("{x}-{y}-{z}"), None, group)?;
    }
    let file = table.into_inner().map_err(|e| Error::io(path, "cannot write")(e.into_error()))?;
    file.commit()
}
