//! `query`: U at points, depth and its deviation along rays.

mod rays;

use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};

use glam::Vec3;

use self::rays::RayQuery;
use super::files::CommandFiles;
use super::opened::open_field;
use super::options::choice;
use super::progress::Bars;
use super::streams;
use octobayes::error::printable;
use octobayes::io::{AtomicFile, refuse_pipe};
use octobayes::monitor::check;
use octobayes::posterior::{Covariance, Scale};
use octobayes::uncertainty::{Answer, Observability, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_data::PointReader;
use octobayes_data::npy;

/// Points that are answered together. More are no faster, and this many with their answers take 30 MB.
const BATCH: usize = 1 << 18;

/// Query the uncertainty at points, or the depth of rays and its deviation
///
/// POINTS are points x,y,z in scene units, or one file of them: `.npy` (N x 3, numbers of any type) or `.csv`. If the
/// first row of a `.csv` names its columns, those named x, y and z are read, in any order; without names there are
/// exactly three. OUT is `.npy` (f64, N x 2: uncertainty, log10 uncertainty) or `.csv` (x,y,z,uncertainty,
/// log10_uncertainty,level,inside,rays,ray_coverage,seen). `-` is CSV on stdin or stdout. Points outside the box get
/// the prior and inside = 0.
///
/// `ray_coverage` counts the training rays that reached the space around a point with half of their light; `seen` is
/// `constrained` (moving the point changes training pixels), `free` (rays passed and met nothing) or `unseen`.
///
/// CSV is answered as it is read: the list may be longer than memory.
///
/// A field with error bars adds a column, `log10_error`: the root mean square error of log10 U, in decades. Where
/// too few rays passed to know it, it is empty in `.csv` and NaN in `.npy`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  octobayes query lego.oct 0,0,0.5 -0.2,0,0.5\n  \
    octobayes query lego.oct points.csv -o answers.csv\n  \
    octobayes query lego.oct --ray 0,-3,0.5,0,1,0 --model lego.safetensors")]
pub struct Args {
    /// The field: `.oct`
    field: PathBuf,

    /// Points x,y,z; or one file of points: `.npy`, `.csv`, or `-`
    #[arg(required_unless_present = "ray", conflicts_with = "ray")]
    points: Vec<PathBuf>,

    #[command(flatten)]
    rays: RayQuery,

    /// Answers: `.npy`, `.csv`, or `-`
    #[arg(short, long, value_name = "OUT", default_value = "-")]
    output: PathBuf,

    /// Read another covariance than the field's own; the field must keep its sums
    #[arg(long, value_parser = choice::<Covariance>())]
    covariance: Option<Covariance>,
}

/// Formats of points and answers.
#[derive(PartialEq)]
enum Format {
    Npy,
    Csv,
    Stream,
}

/// Where points come from.
enum Source {
    File(PathBuf, Format),
    /// The command line, as rows of CSV.
    Typed(String),
}

impl Source {
    /// What POINTS mean; `None` if there are none.
    fn of(points: &[PathBuf]) -> Result<Option<Self>> {
        let typed = |point: &PathBuf| point.to_str().filter(|text| is_point(text)).map(str::to_string);
        match points {
            [] => Ok(None),
            [file] if typed(file).is_none() => Ok(Some(Self::File(file.clone(), format(file)?))),
            several => match several.iter().find(|point| typed(point).is_none()) {
                Some(other) => {
                    let expected = "one file, or points as x,y,z without spaces, such as 0,0,0.5";
                    let other = other.to_string_lossy();
                    Err(Error::setting("POINTS", expected, format!("{} among others", other.trim())))
                }
                None => Ok(Some(Self::Typed(several.iter().filter_map(typed).collect::<Vec<_>>().join("\n")))),
            },
        }
    }

    /// The file, if it is one.
    fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path, Format::Npy | Format::Csv) => Some(path),
            _ => None,
        }
    }
}

/// Whether a word is a point rather than a file: numbers between commas.
fn is_point(word: &str) -> bool {
    word.contains(',') && word.split(',').all(|number| number.trim().parse::<f64>().is_ok())
}

/// Whether a word is a point, or its first coordinate, that begins with a minus.
fn is_negative(word: &str) -> bool {
    word.starts_with('-') && (is_point(word) || word.parse::<f64>().is_ok())
}

/// The words of a command line, in which a point or a number that begins with a minus is no option: a space goes before
/// it.
pub fn with_points(words: impl Iterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    let mut takes_points = false;
    words.enumerate().map(move |(i, word)| {
        // The verb, which only `--threads N` may precede.
        takes_points |= i <= 3 && (word == "query" || word == "measure");
        let begins_so = takes_points && word.to_str().is_some_and(is_negative);
        if begins_so { [OsStr::new(" "), &word].into_iter().collect() } else { word }
    })
}

fn format(path: &Path) -> Result<Format> {
    match (path.to_str(), path.extension().and_then(|e| e.to_str())) {
        (Some("-"), _) => Ok(Format::Stream),
        (_, Some("npy")) => Ok(Format::Npy),
        (_, Some("csv")) => Ok(Format::Csv),
        _ => Err(Error::extension(path, "`.npy`, `.csv` or `-`")),
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        let source = Source::of(&std::mem::take(&mut self.points))?;
        let output = format(&self.output)?;
        // A read from stdin or a pipe blocks, so Ctrl-C must end the process at once.
        let waits = match &source {
            Some(Source::File(path, format)) => *format == Format::Stream || refuse_pipe(path).is_err(),
            _ => false,
        };
        if !waits {
            bars.listen();
        }
        let named = |path: &Path| (path != Path::new("-")).then(|| path.to_path_buf());
        CommandFiles::default()
            .input("FIELD", &self.field)
            .inputs("POINTS", source.as_ref().and_then(Source::file))
            .inputs("--model", &self.rays.model)
            .outputs("--output", named(&self.output))
            .check()?;
        let mut field = open_field(&self.field)?;
        if field.record().scale == Scale::Paper {
            announce!(
                "note: U of this field ranks places and is no length: it is in the paper's scale (`uncertainty --scale \
                 data` computes standard deviations in scene units)"
            );
        }
        if let Some(covariance) = self.covariance {
            let had_error_bars = field.error_bars().is_some();
            field = field.with_covariance(covariance)?;
            if had_error_bars && field.error_bars().is_none() {
                announce!("note: the field's error bars are not those of `{}`: no log10_error", covariance.name());
            }
        }
        let Some(source) = source else { return self.answer_rays(&field, &output, bars) };
        self.answer_points(&field, open(&source)?, &output, bars)
    }

    fn answer_points(&self, field: &UncertaintyField, mut points: PointReader, to: &Format, bars: &Bars) -> Result<()> {
        if *to == Format::Npy {
            return write_npy(&self.output, field, &mut points, bars);
        }
        written(&self.output, to, |out| write_csv(out, field, &mut points, bars))
    }

    fn answer_rays(self, field: &UncertaintyField, output: &Format, bars: &Bars) -> Result<()> {
        if *output == Format::Npy {
            let expected = "`.csv` or `-` for the answers of --ray";
            return Err(Error::malformed(&self.output, "file name", expected, "`.npy`"));
        }
        let Self { field: path, output: to, rays, .. } = self;
        written(&to, output, |out| rays.answer(&path, field, out, bars))
    }
}

/// Lets `write` write to a file or to stdout. Its inner error is that of what it writes to.
fn written(
    path: &Path,
    format: &Format,
    write: impl FnOnce(&mut dyn Write) -> Result<std::io::Result<()>>,
) -> Result<()> {
    if *format == Format::Csv {
        let mut file = AtomicFile::create(path)?;
        write(&mut file)?.map_err(Error::io(path, "cannot write"))?;
        return file.commit();
    }
    let written = write(&mut std::io::stdout().lock()).map_err(|error| match error {
        Error::Interrupted => Error::InterruptedAfter { finished: "more answers were to come".into() },
        other => other,
    });
    streams::arrived(written?)
}

/// Starts reading the points. Says on stderr which columns are not read.
fn open(source: &Source) -> Result<PointReader<'_>> {
    let (points, path) = match source {
        Source::File(path, Format::Npy) => (PointReader::npy(path)?, path.as_path()),
        Source::File(path, Format::Csv) => {
            let file = File::open(path).map_err(Error::io(path, "cannot open"))?;
            (PointReader::csv(BufReader::new(file), path)?, path.as_path())
        }
        Source::File(_, Format::Stream) => {
            (PointReader::csv(std::io::stdin().lock(), Path::new("stdin"))?, Path::new("stdin"))
        }
        Source::Typed(rows) => (PointReader::csv(rows.as_bytes(), Path::new("POINTS"))?, Path::new("POINTS")),
    };
    if !points.ignored().is_empty() {
        let others = printable(&points.ignored().join(", "));
        announce!("note: columns x, y and z of {} are read, others are not: {others}", path.display());
    }
    Ok(points)
}

fn write_npy(path: &Path, field: &UncertaintyField, points: &mut PointReader, bars: &Bars) -> Result<()> {
    let columns = if field.error_bars().is_some() { 3 } else { 2 };
    // The number of rows stands at the start of the file, so that all must be read first.
    let answers = field.answers(&points.rest()?);
    check(bars)?;
    let row =
        |Answer { estimate: a, .. }: &Answer| [a.uncertainty, a.uncertainty.log10(), a.log10_error.unwrap_or(f64::NAN)];
    let values = answers.iter().flat_map(|a| row(a).into_iter().take(columns));
    npy::write(path, &[answers.len() as u64, columns as u64], values)
}

/// Answers batch by batch. The inner error is that of `out`, the outer one that of the points.
fn write_csv(
    out: &mut dyn Write,
    field: &UncertaintyField,
    points: &mut PointReader,
    bars: &Bars,
) -> Result<std::io::Result<()>> {
    let with_errors = field.error_bars().is_some();
    let mut writer = csv::Writer::from_writer(out);
    let header = ["x", "y", "z", "uncertainty", "log10_uncertainty", "level", "inside", "rays", "ray_coverage", "seen"];
    if let Err(error) = writer.write_record(header.iter().chain(with_errors.then_some(&"log10_error"))) {
        return Ok(Err(streams::of_csv(error)));
    }
    loop {
        check(bars)?;
        let batch = points.batch(BATCH)?;
        if batch.is_empty() {
            return Ok(writer.flush());
        }
        let answers = field.answers(&batch);
        if let Err(error) = write_rows(&mut writer, &batch, &answers, with_errors) {
            return Ok(Err(error));
        }
    }
}

fn write_rows<W: Write>(
    writer: &mut csv::Writer<W>,
    points: &[Vec3],
    answers: &[Answer],
    with_errors: bool,
) -> std::io::Result<()> {
    for (x, Answer { estimate: a, ray_coverage, observability, .. }) in points.iter().zip(answers) {
        let numbers = [x.x.to_string(), x.y.to_string(), x.z.to_string(), a.uncertainty.to_string()];
        let rays = a.rays.map_or(String::new(), |rays| rays.to_string());
        let ray_coverage = ray_coverage.map_or(String::new(), |ray_coverage| ray_coverage.to_string());
        let seen = observability.map_or("", Observability::name).to_string();
        let inside = u8::from(a.inside).to_string();
        let rest = [a.uncertainty.log10().to_string(), a.level.to_string(), inside, rays, ray_coverage, seen];
        let error = with_errors.then(|| a.log10_error.map_or(String::new(), |error| error.to_string()));
        writer.write_record(numbers.iter().chain(&rest).chain(&error)).map_err(streams::of_csv)?;
    }
    writer.flush()
}
