//! All photographs in numbers.

use std::path::Path;

use octobayes::io::AtomicFile;
use octobayes::{Error, Result};
use octobayes_depth::Trust;

use super::view::{MapSettings, Quality};
use super::{Unit, figure};

/// Where less of the surfaces is trusted, something is wrong: models of eight to twelve photographs had two thirds.
const FEW: f64 = 0.1;

/// The share of a reason, of the pixels that show a surface; `None` if there is none.
pub fn share_of_surface(quality: &Quality, trust: Trust) -> Option<f64> {
    let surface = 1.0 - quality.shares[Trust::Transparent as usize];
    (surface > 0.0).then(|| quality.shares[trust as usize] / surface)
}

/// Writes a line for each photograph. Shares are of the pixels that show a surface, but for the transparent ones.
pub fn write_quality(path: &Path, rows: &[Quality], settings: &MapSettings) -> Result<()> {
    let failed = |e: csv::Error| Error::io(path, "cannot write")(e.into());
    let mut table = csv::Writer::from_writer(AtomicFile::create(path)?);
    let unit = if settings.unit.is_known { "_m" } else { "" };
    let lengths = ["median_depth", "median_sigma", "sigma_q95"].map(|name| format!("{name}{unit}"));
    let shares = ["trusted", "never_seen", "in_front", "no_agreement", "transparent"].map(String::from);
    let head = ["photograph".into(), "pixels".into()].into_iter().chain(lengths).chain(shares);
    table.write_record(head.collect::<Vec<String>>()).map_err(failed)?;
    for row in rows {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.6}"));
        // Lengths may be of any size.
        let of_length = |value: Option<f64>| value.map_or(String::new(), |value| figure(value, 1e-3 * value));
        let of = [Trust::Trusted, Trust::NeverSeen, Trust::InFront, Trust::NoAgreement];
        let shares = of.map(|trust| number(share_of_surface(row, trust)));
        let cells = [
            row.name.clone(),
            row.pixels.to_string(),
            of_length(row.depth),
            of_length(row.sigma.map(|sigma| sigma[0])),
            of_length(row.sigma.map(|sigma| sigma[1])),
        ];
        let transparent = number(Some(row.shares[Trust::Transparent as usize]));
        table.write_record(cells.into_iter().chain(shares).chain([transparent])).map_err(failed)?;
    }
    let file = table.into_inner().map_err(|e| Error::io(path, "cannot write")(e.into_error()))?;
    file.commit()
}

/// Shares of what all photographs together show, in the order of [`Trust`]; `None` if they show nothing.
pub fn shares(rows: &[Quality]) -> Option<[f64; Trust::ALL.len()]> {
    let pixels = |row: &Quality, trust: Trust| row.pixels as f64 * row.shares[trust as usize];
    let all = |trust: Trust| rows.iter().map(|row| pixels(row, trust)).sum::<f64>();
    let surface: f64 = Trust::ALL.iter().filter(|trust| **trust != Trust::Transparent).map(|trust| all(*trust)).sum();
    (surface > 0.0).then(|| Trust::ALL.map(|trust| all(trust) / surface))
}

/// Says in two lines what was found.
pub fn announce_summary(rows: &[Quality], unit: Unit) {
    let Some(shares) = shares(rows) else {
        announce!("warning: no photograph shows a surface");
        return;
    };
    let percent = |trust: Trust| format!("{:.1} % {trust}", 100.0 * shares[trust as usize]);
    let why = [Trust::NeverSeen, Trust::InFront, Trust::NoAgreement].map(percent);
    announce!("note: of what photographs show, {}; {}", percent(Trust::Trusted), why.join(", "));
    if shares[Trust::Trusted as usize] < FEW {
        announce!(
            "warning: training cameras hardly ever agree on a surface; likely causes: a model that shows its images \
             poorly, cameras of another scene or with other axes, or very few photographs"
        );
    }
    let mut medians: Vec<f64> = rows.iter().filter_map(|row| Some(row.sigma?[0])).collect();
    medians.sort_unstable_by(f64::total_cmp);
    if !medians.is_empty() {
        let median = octobayes::metrics::quantile(&medians, 0.5);
        announce!(
            "note: where depth can be trusted, its deviation is {median:.2e} {} (in the median photograph)",
            unit.name()
        );
    }
}
