//! `clean`: removes what a trained scene would be better without.

mod found;
mod page;
mod picture;
mod refit;
mod splats;
mod volume;

use std::path::PathBuf;

use glam::Vec3;
use serde_json::json;

use self::found::{Found, announce_counts, check_strength, counts, write_report};
use self::picture::Pictures;
use self::refit::Refit;
use self::splats::FoundSplats;
use self::volume::FoundVolume;
use super::files::CommandFiles;
use super::opened::open_field;
use super::options::{CameraOptions, FrameOptions, ModelArgument, TrainingOptions, choice, count, heading};
use super::progress::Bars;
use super::streams::tell;
use octobayes::monitor::Message;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_clean::{Baking, Clean, Cleaned, Strength, VolumeFile};
use octobayes_data::Part;
use octobayes_session::{CheckedViews, Choices, OpenedModel, Session};
use octobayes_splats::Splats;
use octobayes_train::Refitted;

/// Level of the grid over which the cameras are checked; no field is computed.
const LEVEL: u8 = 6;

octobayes::choices! {
    /// What removal is based on.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    pub enum By {
        #[default]
        Views = "views", "what the training views show";
        Uncertainty = "uncertainty", "U of FIELD.oct alone, as in the paper: 99.9 %, 99 % or 95 % of visible surfaces stay";
    }
}

/// Remove floaters, and what no camera saw, from Gaussian splats or a volume
///
/// Looks at the model through the training cameras. A splat, or a cell of a volume, goes if it hangs in the air in
/// front of the surfaces that most views show, if no view shows it, if it is far outside everything, or if it is nearly
/// transparent. What floats is removed before the next look, as one floater can hide another. No image is needed; those
/// that lie beside the cameras are compared with the model first, as in `uncertainty`.
///
/// OUTPUT has the format of its extension. A `.ply` keeps all properties of the file. What was removed of splats is
/// written beside it, with the reason of each as a column. A `.safetensors` is the hash grid of `train` that was read,
/// with fewer occupied cells; any other volume becomes a voxel grid, `.npz`. Pixels that masks leave out do not count.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes clean scene.ply --cameras sparse/0 -o clean.ply\n  \
    octobayes clean scene.spz --cameras cameras.json --strength careful -o clean.spz --page clean.html\n  \
    octobayes clean fox.safetensors -o clean.safetensors")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// A field of the model: its U becomes a column, and may decide what is removed (`--by uncertainty`)
    #[arg(value_name = "FIELD.oct", help_heading = heading::INPUT)]
    field: Option<PathBuf>,

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

    /// What removal is based on
    #[arg(long, value_parser = choice::<By>(), default_value = By::default().name(), help_heading = heading::STATISTICS)]
    by: By,

    /// Train the splats that are left for N steps on the images beside the cameras; none is added
    #[arg(long, value_name = "STEPS", value_parser = count::<u64>(1..=1_000_000), help_heading = heading::OUTPUT)]
    refit: Option<u64>,

    /// Pixels of all views together that are looked at; each takes 12 bytes for every splat or cell that it shows
    #[arg(
        long,
        value_name = "N",
        default_value_t = Clean::PIXELS,
        value_parser = count::<u64>(1..=1_000_000_000),
        help_heading = heading::RAYS,
        hide_short_help = true,
    )]
    pixels: u64,

    /// Where to write what is left: `.ply`, `.compressed.ply`, `.spz` or `.splat`; of a volume `.safetensors` or `.npz`
    #[arg(short, long, value_name = "OUTPUT", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Points along the longest edge of an `.npz`, of a volume that is no voxel grid; each takes 16 bytes
    #[arg(
        long,
        value_name = "N",
        default_value_t = Baking::POINTS,
        value_parser = count::<u32>(2..=1024),
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    points: u32,

    /// Where to write the splats that were removed, with their reasons [default: OUTPUT with `.removed.ply` for its
    /// extension]
    #[arg(long, value_name = "REMOVED.ply", help_heading = heading::OUTPUT)]
    removed: Option<PathBuf>,

    /// Write a row for each splat, or cell that pixels show or no image has: position, reason, the first strength that
    /// removes it, and what views show of it
    #[arg(long, value_name = "REPORT.csv", help_heading = heading::OUTPUT)]
    report: Option<PathBuf>,

    /// Draw one view before and after, and between them what goes, coloured by its reason
    #[arg(long, value_name = "PICTURE.png", help_heading = heading::OUTPUT)]
    picture: Option<PathBuf>,

    /// Write a page of some views before and after, with a slider from careful to strong
    #[arg(long, value_name = "PAGE.html", help_heading = heading::OUTPUT)]
    page: Option<PathBuf>,

    /// Print counts as one JSON object
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        let removed = self.removed.clone().unwrap_or_else(|| splats::beside(&self.output));
        let has_removed = self.removed.is_some() || octobayes_models::is_of_splats(&self.model.model);
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .inputs("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output)
            .outputs("--removed", has_removed.then_some(&removed))
            .outputs("--report", &self.report)
            .outputs("--picture", &self.picture)
            .outputs("--page", &self.page);
        files.check()?;
        if has_removed && !Splats::takes_columns(&removed) {
            let expected = "a name that ends in `.ply`, but not in `.compressed.ply`, which has no place for reasons";
            return Err(Error::setting("--removed", expected, removed.display().to_string()));
        }
        let field = self.field.as_deref().map(open_field).transpose()?;
        if self.by == By::Uncertainty && field.is_none() {
            return Err(Error::setting("--by uncertainty", "FIELD.oct after MODEL: `octobayes uncertainty`", "none"));
        }
        let model = match field.as_ref().zip(self.field.as_ref()) {
            Some((field, path)) => {
                if let Some(mode) = self.training.splat_mode {
                    let expected = "none beside FIELD, which was computed in one";
                    return Err(Error::setting("--splat-mode", expected, mode.to_string()));
                }
                OpenedModel::of_field(field, path, &self.model.model, self.training.force, &mut tell)?
            }
            None => {
                let has_cameras = self.cameras.cameras.is_some();
                OpenedModel::for_cameras(&self.model.model, has_cameras, self.training.splat_mode)?
            }
        };
        let splats = Splats::of(&*model.model);
        let file = self.check_output(&model, splats)?;
        let cameras = self.cameras.training(&self.frames, Some(&*model.model), &self.model.model)?;
        files.images(&cameras.views).check()?;
        let refit = splats.zip(self.refit).map(|(splats, steps)| Refit::new(splats, &cameras.views, steps));
        let refit = refit.transpose()?;
        let limits = self.limits(field.as_ref())?;
        let background = self.training.background.unwrap_or(Vec3::ONE);
        let (domain, messages) = model.model.covered(&cameras.views.cameras(), background, bars)?;
        // Its notes are about a field, but none is computed.
        messages.into_iter().filter(|message| matches!(message, Message::Warning(_))).for_each(tell);
        let session = Session::new(cameras.views, format!("{} seen by {}", model.source, cameras.source))?
            .domain(Some(domain))
            .choices(Choices { level: Some(LEVEL), ..Choices::default() })
            .background(self.training.background)
            .model_file(Some(PathBuf::from(&model.name)))
            .force(self.training.force);
        // What is wrong with the cameras is found before they are held against the model.
        let views = session.prepare(&*model.model, bars, &mut tell)?.checked_views();
        let clean = Clean::new(views.cameras)
            .masks(views.masks)
            .pixel_offset(views.pixel_offset)
            .pixels(self.pixels)
            .monitor(bars);
        match (splats, &file) {
            (Some(splats), _) => {
                let cleaned = with_field(clean.splats(splats)?, splats.means(), field.as_ref(), limits);
                let mut found = FoundSplats { splats, cleaned, options: self.options() };
                check_strength(&found, self.strength)?;
                found.write(self.strength, &self.output, &removed)?;
                self.show(&found, &views, bars)?;
                let mut psnr = None;
                if let Some(refit) = &refit {
                    // All other files are there already: an interruption loses no more than these steps.
                    let trained = refit.run(&found.part(self.strength, false)?, views.background, bars);
                    let trained = trained.inspect_err(|_| {
                        announce!("note: {} holds what is left, without training", self.output.display());
                    })?;
                    if let Some(Refitted { splats, psnr: found_psnr }) = trained {
                        psnr = found_psnr;
                        found.options += &format!(" --refit {}", refit.steps);
                        found.write_left(&splats, self.strength, &self.output)?;
                    } else {
                        tell(Message::Warning(format!(
                            "training made the images worse, so that {} holds what is left without it",
                            self.output.display()
                        )));
                    }
                }
                self.print(&found, Some(&removed), psnr)
            }
            (None, file) => {
                let clean = clean.hidden(self.by == By::Uncertainty);
                let (model, file) = (&*model.model, file.as_ref().expect("the file of a volume"));
                let density = octobayes_models::volume(model, &self.model.model)?;
                let mut found = clean.volume(model, file.cells(model, self.points)?)?;
                let centers = found.centers();
                found.cleaned = with_field(found.cleaned, &centers, field.as_ref(), limits);
                let found = FoundVolume { model, field: density, file, found };
                check_strength(&found, self.strength)?;
                let eyes: Vec<Vec3> = views.cameras.iter().map(|camera| camera.position.as_vec3()).collect();
                let baking = Baking { model, points: self.points, eyes: &eyes };
                file.write(&found.found, self.strength, &self.output, &baking, bars)?;
                self.show(&found, &views, bars)?;
                self.print(&found, None, None)
            }
        }
    }

    /// log10 U above which parts go, at each strength, if that decides.
    fn limits(&self, field: Option<&UncertaintyField>) -> Result<Option<[f64; 3]>> {
        let Some(field) = field.filter(|_| self.by == By::Uncertainty) else { return Ok(None) };
        let Some(limits) = field.surface_quantiles(Cleaned::SURFACES) else {
            let expected = "a field with points on visible surfaces: they set the limits";
            return Err(Error::setting("--by uncertainty", expected, "one without"));
        };
        let (limit, share) = (limits[self.strength as usize], 100.0 * Cleaned::SURFACES[self.strength as usize]);
        announce!("note: log10 U is at most {limit:.3} on {share}% of the visible surfaces");
        Ok(Some(limits))
    }

    /// Options that change what goes, beside the strength.
    fn options(&self) -> String {
        if self.by == By::Uncertainty { format!(" --by {}", self.by) } else { String::new() }
    }

    /// Refuses a file that cannot hold what is left, and says what it will lose. The model's own file, of a volume.
    fn check_output(&self, model: &OpenedModel, splats: Option<&Splats>) -> Result<Option<VolumeFile>> {
        let Some(splats) = splats else {
            if let Some(steps) = self.refit {
                let expected = "Gaussian splats; a volume is trained by `octobayes train`";
                return Err(Error::setting("--refit", expected, format!("{steps} steps of {}", model.name)));
            }
            if let Some(path) = &self.removed {
                let expected = "Gaussian splats; the file of a volume stays as it is";
                return Err(Error::setting("--removed", expected, format!("{} of {}", path.display(), model.name)));
            }
            let file = VolumeFile::of(&model.name)?;
            let baking = Baking { model: &*model.model, points: self.points, eyes: &[] };
            if let Some(lost) = file.not_kept(&self.output, &baking)? {
                tell(Message::Warning(format!("{} has no place for {lost}", self.output.display())));
            }
            return Ok(Some(file));
        };
        for lost in splats.not_kept(&self.output)? {
            tell(Message::Warning(format!("{} has no place for {lost}", self.output.display())));
        }
        Ok(None)
    }

    /// Writes the files that people look at.
    fn show(&self, found: &dyn Found, views: &CheckedViews, bars: &Bars) -> Result<()> {
        self.report.as_ref().map_or(Ok(()), |path| write_report(path, found))?;
        let pictures = Pictures { found, cameras: views.cameras, background: views.background, monitor: bars };
        if let Some(path) = &self.picture {
            picture::write(path, &pictures, self.strength)?;
        }
        self.page.as_ref().map_or(Ok(()), |path| page::write(path, &pictures, self.strength, &self.model.model))
    }

    /// `psnr` on training images before and after the steps of `--refit`, if these were taken, dB.
    fn print(&self, found: &dyn Found, removed: Option<&PathBuf>, psnr: Option<[f64; 2]>) -> Result<()> {
        let gone: usize = found.cleaned().counts(self.strength).iter().sum();
        let written = removed.filter(|_| gone > 0);
        if self.json {
            let mut object = json!({
                "version": env!("CARGO_PKG_VERSION"),
                "model": self.model.model,
                "output": self.output.display().to_string(),
                "removed": written.map(|path| path.display().to_string()),
                "strength": self.strength,
                "by": self.by,
                "field": self.field.as_ref().map(|path| path.display().to_string()),
                "refit": psnr.zip(self.refit).map(|([before, after], steps)| {
                    json!({ "steps": steps, "training_psnr": { "before": before, "after": after } })
                }),
            });
            let members = object.as_object_mut().expect("an object is made");
            members.extend(counts(found, self.strength).as_object().expect("counts are an object").clone());
            return say!("{object}");
        }
        announce_counts(found, self.strength);
        if let Some(path) = removed.filter(|path| gone == 0 && path.exists()) {
            announce!("note: {} is of an earlier run: nothing goes now", path.display());
        }
        say!("{}", self.output.display())?;
        written.map_or(Ok(()), |path| say!("{}", path.display()))
    }
}

/// What goes, once a field is there; by its limits of log10 U, if that decides.
fn with_field(
    cleaned: Cleaned,
    centers: &[Vec3],
    field: Option<&UncertaintyField>,
    limits: Option<[f64; 3]>,
) -> Cleaned {
    let Some(field) = field else { return cleaned };
    let cleaned = cleaned.with_field(centers, field);
    let outside = cleaned.uncertainty.iter().flatten().filter(|estimate| !estimate.inside).count();
    if outside > 0 && limits.is_some() {
        let n = centers.len();
        announce!("note: {outside} of {n} parts lie outside the field's box, where no U is known: they stay");
    }
    match limits {
        Some(limits) => cleaned.by_uncertainty(limits),
        None => cleaned,
    }
}
