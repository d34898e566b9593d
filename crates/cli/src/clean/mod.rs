//! `clean`: removes what a trained scene would be better without.

mod picture;

use std::path::{Path, PathBuf};

use glam::Vec3;
use serde_json::json;

use self::picture::BeforeAfter;
use super::files::CommandFiles;
use super::options::{CameraOptions, FrameOptions, ModelArgument, TrainingOptions, choice, count, heading};
use super::progress::Bars;
use super::streams::tell;
use octobayes::estimate::Model;
use octobayes::io::AtomicFile;
use octobayes::monitor::Message;
use octobayes::{Error, Result};
use octobayes_clean::{Clean, Cleaned, Reason, Strength};
use octobayes_data::Part;
use octobayes_session::{Choices, OpenedModel, Session};
use octobayes_splats::Splats;

/// Level of the grid over which the cameras are checked; no field is computed.
const LEVEL: u8 = 6;

/// Remove floaters, and what no camera saw, from Gaussian splats
///
/// Looks at the splats through the training cameras. A splat goes if it hangs in the air in front of the surfaces that
/// most views show, if no view shows it, if it is far outside everything, or if it is nearly transparent. What floats
/// is removed before the next look, as one floater can hide another. No image is needed; those that lie beside the
/// cameras are compared with the model first, as in `uncertainty`.
///
/// OUTPUT has the format of its extension; a `.ply` keeps all properties of the file. What was removed is written
/// beside it, with the reason of each splat as a column. Pixels that masks leave out do not count.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes clean scene.ply --cameras sparse/0 -o clean.ply\n  \
    octobayes clean scene.spz --cameras cameras.json --strength careful -o clean.spz --report clean.csv")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    frames: FrameOptions,

    #[command(flatten)]
    training: TrainingOptions,

    /// How much goes: careful, normal or strong
    #[arg(
        long,
        value_parser = choice::<Strength>(),
        default_value = Strength::default().name(),
        help_heading = heading::STATISTICS,
    )]
    strength: Strength,

    /// Pixels of all views together that are looked at; each takes 12 bytes for every splat that it shows
    #[arg(
        long,
        value_name = "N",
        default_value_t = Clean::PIXELS,
        value_parser = count::<u64>(1..=1_000_000_000),
        help_heading = heading::RAYS,
        hide_short_help = true,
    )]
    pixels: u64,

    /// Where to write what is left: `.ply`, `.compressed.ply`, `.spz` or `.splat`
    #[arg(short, long, value_name = "OUTPUT", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Where to write what was removed, with its reasons [default: OUTPUT with `.removed.ply` for its extension]
    #[arg(long, value_name = "REMOVED.ply", help_heading = heading::OUTPUT)]
    removed: Option<PathBuf>,

    /// Write a row for every splat that was read: its place, why and at which strength it goes, what views show of it
    #[arg(long, value_name = "REPORT.csv", help_heading = heading::OUTPUT)]
    report: Option<PathBuf>,

    /// Draw one view before and after, and between them what goes, coloured by its reason
    #[arg(long, value_name = "PICTURE.png", help_heading = heading::OUTPUT)]
    picture: Option<PathBuf>,

    /// Print counts as one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        let removed = self.removed.clone().unwrap_or_else(|| beside(&self.output));
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output)
            .output("--removed", &removed)
            .outputs("--report", &self.report)
            .outputs("--picture", &self.picture);
        files.check()?;
        if !Splats::takes_columns(&removed) {
            let expected = "a name that ends in `.ply`, but not in `.compressed.ply`, which has no place for reasons";
            return Err(Error::setting("--removed", expected, removed.display().to_string()));
        }
        let model =
            OpenedModel::for_cameras(&self.model.model, self.cameras.cameras.is_some(), self.training.splat_mode)?;
        let splats = Splats::of(&*model.model).ok_or_else(|| {
            let expected = "Gaussian splats; of volumes `uncertainty` finds what is loosely held, and \
                            `render --threshold` shows them without";
            Error::setting("MODEL", expected, format!("{} ({})", model.name, model.model.kind()))
        })?;
        for lost in splats.not_kept(&self.output)? {
            tell(Message::Warning(format!("{} has no place for {lost}", self.output.display())));
        }
        let cameras = self.cameras.training(&self.frames, Some(&*model.model), &self.model.model)?;
        files.images(&cameras.views).check()?;
        let background = self.training.background.unwrap_or(Vec3::ONE);
        let (domain, messages) = splats.covered(&cameras.views.cameras(), background, bars)?;
        // Its notes are about a field, which there is none of.
        messages.into_iter().filter(|message| matches!(message, Message::Warning(_))).for_each(tell);
        let session = Session::new(cameras.views, format!("{} seen by {}", model.source, cameras.source))?
            .domain(Some(domain))
            .choices(Choices { level: Some(LEVEL), ..Choices::default() })
            .background(self.training.background)
            .model_file(Some(PathBuf::from(&model.name)))
            .force(self.training.force);
        // What is wrong with the cameras is found before they are held against the splats.
        let views = session.prepare(&*model.model, bars, &mut tell)?.checked_views();
        let cleaned = Clean::new(splats, views.cameras)
            .masks(views.masks)
            .pixel_offset(views.pixel_offset)
            .pixels(self.pixels)
            .monitor(bars)
            .run()?;
        let left = self.write(splats, &cleaned, &removed)?;
        if let Some(path) = &self.picture {
            let reasons = &cleaned.removed(self.strength);
            let (cameras, background) = (views.cameras, views.background);
            BeforeAfter { splats, left: &left, reasons, cameras, background }.write(path, bars)?;
        }
        self.print(&cleaned, &removed)
    }

    fn write(&self, splats: &Splats, cleaned: &Cleaned, removed_path: &Path) -> Result<Splats> {
        let reasons = cleaned.removed(self.strength);
        let kept: Vec<bool> = reasons.iter().map(Option::is_none).collect();
        if !kept.contains(&true) {
            let found = format!("{}, at which all {} splats go", self.strength, kept.len());
            return Err(Error::setting("--strength", "one that leaves some splats", found));
        }
        let left = splats.clone().keep(&kept)?;
        let gone: Vec<bool> = kept.iter().map(|kept| !kept).collect();
        // What was removed first: nothing is lost if the disk is full.
        if gone.contains(&true) {
            write_columns(&splats.clone().keep(&gone)?, removed_path, cleaned, &gone, self.strength)?;
        }
        self.report.as_ref().map_or(Ok(()), |path| write_report(path, splats, cleaned))?;
        if Splats::takes_columns(&self.output) {
            write_columns(&left, &self.output, cleaned, &kept, self.strength)?;
        } else {
            left.write(&self.output)?;
        }
        Ok(left)
    }

    fn print(&self, cleaned: &Cleaned, removed: &Path) -> Result<()> {
        let n = cleaned.removals.len();
        let counts = cleaned.counts(self.strength);
        let gone: usize = counts.iter().sum();
        if self.json {
            let of = |strength: Strength| {
                let counts = cleaned.counts(strength);
                Reason::ALL.iter().map(|reason| (reason.name().to_string(), json!(counts[*reason as usize]))).collect()
            };
            let strengths: serde_json::Map<String, serde_json::Value> = Strength::ALL
                .iter()
                .map(|&strength| (strength.name().into(), serde_json::Value::Object(of(strength))))
                .collect();
            return say!(
                "{}",
                json!({
                    "version": env!("CARGO_PKG_VERSION"),
                    "model": self.model.model,
                    "output": self.output.display().to_string(),
                    "removed": (gone > 0).then(|| removed.display().to_string()),
                    "strength": self.strength,
                    "splats": n,
                    "left": n - gone,
                    "reasons": of(self.strength),
                    "reasons_by_strength": strengths,
                    "pixels": cleaned.pixels[0],
                    "looks": cleaned.looks,
                })
            );
        }
        let share = |count: usize| 100.0 * count as f64 / n as f64;
        announce!("removed {gone} of {n} splats ({:.2} %), {}:", share(gone), self.strength);
        for (reason, count) in Reason::ALL.iter().zip(counts).filter(|(_, count)| *count > 0) {
            announce!("{count:>9} {} ({:.2} %)", reason.sentence(), share(count));
        }
        let others = Strength::ALL.into_iter().filter(|strength| *strength != self.strength);
        let others: Vec<String> = others
            .map(|strength| format!("{strength} {:.2} %", share(cleaned.counts(strength).iter().sum())))
            .collect();
        announce!("other values of --strength: {}", others.join(", "));
        if gone == 0 && removed.exists() {
            announce!("note: {} is of an earlier run: nothing goes now", removed.display());
        }
        say!("{}", self.output.display())?;
        if gone > 0 { say!("{}", removed.display()) } else { Ok(()) }
    }
}

/// The default file of what is removed.
fn beside(output: &Path) -> PathBuf {
    let stem = output.with_extension("");
    // Of `scene.compressed.ply`, too.
    let stem = if stem.extension().is_some_and(|e| e.eq_ignore_ascii_case("compressed")) {
        stem.with_extension("")
    } else {
        stem
    };
    let name = stem.file_name().unwrap_or_default().to_string_lossy().into_owned();
    stem.with_file_name(format!("{name}.removed.ply"))
}

/// Writes the splats that `chosen` (`[n]`) selects, with columns of what the views show of them.
fn write_columns(splats: &Splats, path: &Path, cleaned: &Cleaned, chosen: &[bool], strength: Strength) -> Result<()> {
    let of = |value: &dyn Fn(usize) -> f64| -> Vec<f32> {
        (0..chosen.len()).filter(|&i| chosen[i]).map(|i| value(i) as f32).collect()
    };
    let removed = cleaned.removed(strength);
    let reason = of(&|i| removed[i].map_or(0.0, |reason| f64::from(reason as u8 + 1)));
    let (front, views) = (of(&|i| cleaned.evidence.front_share(i)), of(&|i| f64::from(cleaned.evidence.views[i])));
    let score = of(&|i| cleaned.scores[i]);
    let version = env!("CARGO_PKG_VERSION");
    let names: Vec<String> =
        Reason::ALL.iter().map(|reason| format!("{} {}", *reason as u8 + 1, reason.name())).collect();
    let comments = [format!(
        "octobayes {version} clean --strength {strength}: octobayes_reason = 0 kept, {}; front_share = part of the \
         splat's weight in front of what the pixels show, and in empty pixels once a view contradicts it; \
         octobayes_score = how far the views contradict it, at most 1; views = training views that show it",
        names.join(", ")
    )];
    let columns: [(&str, &[f32]); 4] =
        [("octobayes_reason", &reason), ("octobayes_score", &score), ("front_share", &front), ("views", &views)];
    splats.write_ply(path, &columns, &comments)
}

/// Writes a row for every splat.
fn write_report(path: &Path, splats: &Splats, cleaned: &Cleaned) -> Result<()> {
    let failed = |e: csv::Error| Error::io(path, "cannot write")(e.into());
    let mut table = csv::Writer::from_writer(AtomicFile::create(path)?);
    let head = ["splat", "x", "y", "z", "reason", "strength", "score", "front_share", "weight", "peak", "views"];
    table.write_record(head).map_err(failed)?;
    for (i, removal) in cleaned.removals.iter().enumerate() {
        let [x, y, z] = splats.mean(i).to_array().map(|v| v.to_string());
        let (reason, strength) = removal.map_or(("kept", ""), |r| (r.reason.name(), r.strength.name()));
        let of = &cleaned.evidence;
        let row = [
            i.to_string(),
            x,
            y,
            z,
            reason.into(),
            strength.into(),
            format!("{:.4}", cleaned.scores[i]),
            format!("{:.4}", of.front_share(i)),
            format!("{:.3e}", of.weight[i]),
            format!("{:.4}", of.peak[i]),
            of.views[i].to_string(),
        ];
        table.write_record(row).map_err(failed)?;
    }
    let file = table.into_inner().map_err(|e| Error::io(path, "cannot write")(e.into_error()))?;
    file.commit()
}
