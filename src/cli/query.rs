//! `query`: U at points.

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::Vec3;

use super::files::CommandFiles;
use super::options::OfficialOptions;
use crate::dataset::points;
use crate::io::{AtomicFile, npy};
use crate::posterior::Covariance;
use crate::uncertainty::Estimate;
use crate::{Error, Result};

/// Query the uncertainty at points
///
/// POINTS is `.npy` (f32 or f64, N x 3) or `.csv` (columns x,y,z; a header is recognised), in scene units. OUT is
/// `.npy` (f64, N x 2: uncertainty, log10 uncertainty) or `.csv`
/// (x,y,z,uncertainty,log10_uncertainty,level,inside,rays). `-` is CSV on stdin or stdout. Points outside the box
/// get the prior and inside = 0.
///
/// A field with error bars adds a column, `log10_error`: the root mean square error of log10 U, in decades. Where
/// too few rays passed to know it, it is empty in `.csv` and NaN in `.npy`.
#[derive(clap::Args)]
#[command(after_help = "Example: echo 0,0,0.5 | octobayes query lego.oct - -o -")]
pub struct Args {
    /// The field: `.oct`, or the official code's `.npy`
    field: PathBuf,

    /// Points: `.npy`, `.csv`, or `-`
    points: PathBuf,

    /// Answers: `.npy`, `.csv`, or `-`
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,

    /// Read another covariance than the field's own; the field must keep its sums
    #[arg(long, value_enum)]
    covariance: Option<Covariance>,

    #[command(flatten)]
    official: OfficialOptions,
}

/// Formats of points and answers.
#[derive(PartialEq)]
enum Format {
    Npy,
    Csv,
    Stream,
}

fn format(path: &Path) -> Result<Format> {
    match (path.to_str(), path.extension().and_then(|e| e.to_str())) {
        (Some("-"), _) => Ok(Format::Stream),
        (_, Some("npy")) => Ok(Format::Npy),
        (_, Some("csv")) => Ok(Format::Csv),
        _ => Err(Error::malformed(path, "file name", "`.npy`, `.csv` or `-`", "another extension")),
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(self) -> Result<()> {
        let (input, output) = (format(&self.points)?, format(&self.output)?);
        let named = |path: &Path| (path != Path::new("-")).then(|| path.to_path_buf());
        CommandFiles::default()
            .input("FIELD", &self.field)
            .inputs("POINTS", named(&self.points))
            .outputs("--output", named(&self.output))
            .check()?;
        let mut field = self.official.read(&self.field)?;
        if let Some(covariance) = self.covariance {
            let had_error_bars = field.error_bars().is_some();
            field = field.with_covariance(covariance)?;
            if had_error_bars && field.error_bars().is_none() {
                eprintln!("note: the field's error bars are not those of `{}`: no log10_error", covariance.name());
            }
        }
        let with_errors = field.error_bars().is_some();
        let points = match input {
            Format::Npy => points::read_npy(&self.points)?,
            Format::Csv => {
                let file = std::fs::File::open(&self.points).map_err(Error::io(&self.points, "cannot open"))?;
                points::read_csv(file, &self.points)?
            }
            Format::Stream => points::read_csv(std::io::stdin().lock(), Path::new("stdin"))?,
        };
        let answers = field.query_all(&points);
        match output {
            Format::Npy => {
                let columns = if with_errors { 3 } else { 2 };
                let row = |a: &Estimate| [a.uncertainty, a.uncertainty.log10(), a.log10_error.unwrap_or(f64::NAN)];
                let values = answers.iter().flat_map(|a| row(a).into_iter().take(columns));
                npy::write(&self.output, &[answers.len() as u64, columns as u64], values)
            }
            Format::Csv => {
                let mut file = AtomicFile::create(&self.output)?;
                write_csv(&mut file, &points, &answers, with_errors)
                    .map_err(Error::io(&self.output, "cannot write"))?;
                file.commit()
            }
            Format::Stream => {
                let out = std::io::stdout().lock();
                match write_csv(out, &points, &answers, with_errors) {
                    // A reader that has seen enough (`| head`) is no failure.
                    Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                        Err(Error::io(Path::new("stdout"), "cannot write")(e))
                    }
                    _ => Ok(()),
                }
            }
        }
    }
}

fn write_csv(out: impl Write, points: &[Vec3], answers: &[Estimate], with_errors: bool) -> std::io::Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    let header = ["x", "y", "z", "uncertainty", "log10_uncertainty", "level", "inside", "rays"];
    writer.write_record(header.iter().chain(with_errors.then_some(&"log10_error")))?;
    for (x, a) in points.iter().zip(answers) {
        let numbers = [x.x.to_string(), x.y.to_string(), x.z.to_string(), a.uncertainty.to_string()];
        let rays = a.rays.map_or(String::new(), |rays| rays.to_string());
        let rest = [a.uncertainty.log10().to_string(), a.level.to_string(), u8::from(a.inside).to_string(), rays];
        let error = with_errors.then(|| a.log10_error.map_or(String::new(), |error| error.to_string()));
        writer.write_record(numbers.iter().chain(&rest).chain(&error))?;
    }
    writer.flush()
}
