//! `compare`: how much two fields differ.

use std::path::PathBuf;

use serde_json::json;

use super::opened::open_field;
use super::options::{MAX_KEPT_COUNT, choice, count};
use super::report;
use super::streams::tell;
use octobayes::Result;
use octobayes::posterior::Covariance;
use octobayes::uncertainty::{Comparison, UncertaintyField, compare};
use octobayes_session::check_fields;

/// Compare two fields: memory, and |Δ log10 U| in the box and on visible surfaces
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes compare lego.oct lego_dense.oct --points 1000000")]
pub struct Args {
    /// One field
    a: PathBuf,

    /// The reference. Surfaces are compared at its surface points, if it has any
    b: PathBuf,

    /// Random points in the box, and at most as many on surfaces
    #[arg(
        long,
        value_name = "N",
        default_value_t = Comparison::POINTS,
        value_parser = count::<usize>(..=MAX_KEPT_COUNT),
    )]
    points: usize,

    /// Read this covariance off both fields
    #[arg(long, value_parser = choice::<Covariance>())]
    covariance: Option<Covariance>,

    /// Compare although the fields are of different models or scales
    #[arg(long)]
    force: bool,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        let read = |path: &PathBuf| -> Result<UncertaintyField> {
            let field = open_field(path)?;
            match self.covariance {
                Some(covariance) => field.with_covariance(covariance),
                None => Ok(field),
            }
        };
        let [a, b] = [&read(&self.a)?, &read(&self.b)?];
        check_fields([(&self.a, a), (&self.b, b)], self.force, &mut tell)?;
        let result = compare(a, b, self.points, 0)?;
        if self.json {
            let mut value = json!(result);
            value["records"] = json!([octobayes::estimate::facts(a), octobayes::estimate::facts(b)]);
            value["files"] = json!([&self.a, &self.b].map(|path| path.to_string_lossy()));
            say!("{value}")?;
        } else {
            for (name, (path, field)) in ["A", "B"].iter().zip([(&self.a, a), (&self.b, b)]) {
                say!("{name} {}\n{}", path.display(), report::record(field))?;
            }
            for (name, summary) in ["A", "B"].iter().zip(&result.fields) {
                say!("{name}: {}", report::summary(summary))?;
            }
            say!("A : B memory {:.4}", result.fields[0].query_bytes as f64 / result.fields[1].query_bytes as f64)?;
            say!("{}", report::comparison(&result))?;
        }
        Ok(())
    }
}
