//! The script that submits shards and their merge to Slurm.

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};

use super::forecast::Forecast;
use crate::cli::report;
use crate::io::AtomicFile;
use crate::{Error, Result};

/// The script, with the names of what differs between two braces each.
const TEMPLATE: &str = include_str!("run.sbatch");
/// Requested memory per expected memory: the pilot does not see everything, and Slurm counts the shell as well.
const MEMORY_MARGIN: f64 = 1.5;
/// Requested time per expected time: nodes may be slower than the machine that plans.
const TIME_MARGIN: f64 = 3.0;
/// Least time, minutes. Slurm's signal may come two minutes before the end, and the run has to begin before that.
const LEAST_MINUTES: u64 = 5;
/// Least memory, MB: the program, its libraries and the shell.
const LEAST_MEGABYTES: u64 = 128;
/// Bytes of parts that `merge` reads and adds up in a second. One core did four times as many, from a warm cache.
const MERGED_PER_SECOND: f64 = 1e8;
/// Memory of a part that was read, per byte of its file.
const IN_MEMORY: f64 = 1.1;

/// What a job asks Slurm for.
#[derive(Debug, Clone, Copy, serde::Serialize)]
pub struct Request {
    /// Memory, Slurm's MB (2^20 bytes).
    pub megabytes: u64,
    pub minutes: u64,
}

impl Request {
    /// The forecast with its margins.
    pub fn new(forecast: &Forecast) -> Self {
        let megabytes = (MEMORY_MARGIN * forecast.peak / f64::from(1 << 20)).ceil() as u64;
        let minutes = (TIME_MARGIN * forecast.time.as_secs_f64() / 60.0).ceil() as u64;
        Self { megabytes: megabytes.max(LEAST_MEGABYTES), minutes: minutes.max(LEAST_MINUTES) }
    }
}

/// What the merge of `shards` parts is expected to need: one part at a time is in memory, beside the sums of the
/// `whole` run, of which a field is made as at its end.
pub fn merge(shards: u64, part: &Forecast, whole: Forecast) -> Forecast {
    let parts = shards as f64 * part.file;
    let time = Duration::from_secs_f64(parts / MERGED_PER_SECOND);
    Forecast { peak: IN_MEMORY * part.file + whole.peak, time, ..whole }
}

/// What a script holds.
pub struct Script {
    pub shards: u64,
    /// CPUs, and threads, of every job.
    pub cpus: u16,
    /// Words behind `octobayes uncertainty`, without those that differ by shard.
    pub run: Vec<OsString>,
    /// Words behind `octobayes`.
    pub merge: Vec<OsString>,
    /// Folder of the parts, their checkpoints and logs.
    pub parts: PathBuf,
    /// The merged field.
    pub field: PathBuf,
    /// Of a shard, and of the merge.
    pub forecasts: [Forecast; 2],
}

impl Script {
    /// Writes the script.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = self.text()?;
        let mut file = AtomicFile::create(path)?;
        file.write_all(&text).map_err(Error::io(path, "cannot write"))?;
        file.commit()
    }

    pub fn json(&self) -> Value {
        let [shard, merge] = self.forecasts.map(|forecast| {
            let mut value = forecast.json();
            value["request"] = json!(Request::new(&forecast));
            value
        });
        json!({
            "shards": self.shards,
            "cpus": self.cpus,
            "shard": shard,
            "merge": merge,
            "parts": self.parts.to_string_lossy(),
            "field": self.field.to_string_lossy(),
        })
    }

    fn text(&self) -> Result<Vec<u8>> {
        let mut text = Vec::new();
        let mut rest = TEMPLATE;
        while let Some((before, (name, behind))) =
            rest.split_once("{{").and_then(|(before, behind)| Some((before, behind.split_once("}}")?)))
        {
            text.extend_from_slice(before.as_bytes());
            text.extend(self.value(name)?);
            rest = behind;
        }
        text.extend_from_slice(rest.as_bytes());
        Ok(text)
    }

    /// What stands in the place of `{{name}}`.
    fn value(&self, name: &str) -> Result<Vec<u8>> {
        let [shard, merge] = &self.forecasts;
        let request = |forecast| {
            let Request { megabytes, minutes } = Request::new(forecast);
            format!("--mem={megabytes}M --time={minutes}")
        };
        let program = || std::env::current_exe().map_err(Error::io(Path::new("octobayes"), "cannot find itself"));
        let here = || std::env::current_dir().map_err(Error::io(Path::new("."), "cannot find its path"));
        Ok(match name {
            "octobayes" => return quoted(program()?.as_os_str()),
            "here" => return quoted(here()?.as_os_str()),
            "run" => return all_quoted(&self.run),
            "merge" => return all_quoted(&self.merge),
            "parts" => return quoted(self.parts.as_os_str()),
            "field" => return quoted(self.field.as_os_str()),
            "name" => return quoted(self.field.file_stem().unwrap_or_default()),
            "version" => env!("CARGO_PKG_VERSION").into(),
            "shards" => self.shards.to_string(),
            "cpus" => self.cpus.to_string(),
            "expected_of_shard" => shard.cost(),
            "expected_of_merge" => merge.cost(),
            "shard_request" => request(shard),
            "merge_request" => request(merge),
            "memory_margin" => MEMORY_MARGIN.to_string(),
            "time_margin" => TIME_MARGIN.to_string(),
            "least_minutes" => LEAST_MINUTES.to_string(),
            _ => unreachable!("the template names nothing else: {name}"),
        }
        .into_bytes())
    }
}

impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [shard, merge] = &self.forecasts;
        let size = report::bytes(shard.file as usize);
        writeln!(f, "shard   {} on {} CPUs, a file of {size}; {} of them", shard.cost(), self.cpus, self.shards)?;
        write!(f, "merge   {}", merge.cost())
    }
}

/// The word as a shell takes it: one, and unchanged.
fn quoted(word: &OsStr) -> Result<Vec<u8>> {
    // Only a NUL cannot be quoted, and no operating system passes one on.
    let refused = |_| Error::setting("a path or option", "no NUL in it", word.to_string_lossy());
    shlex::bytes::try_quote(word.as_encoded_bytes()).map(std::borrow::Cow::into_owned).map_err(refused)
}

fn all_quoted(words: &[OsString]) -> Result<Vec<u8>> {
    let words = words.iter().map(|word| quoted(word)).collect::<Result<Vec<_>>>()?;
    Ok(words.join(&b' '))
}
