//! `view`: a viewer in one file.

use std::path::{Path, PathBuf};

use glam::Vec3;

use super::depth::UnitOptions;
use super::files::CommandFiles;
use super::opened::open_field;
use super::options::{CameraOptions, ModelArgument, count, heading, parse_range};
use super::progress::Bars;
use super::render::bar_of;
use super::report;
use super::streams::tell;
use octobayes::geometry::Camera;
use octobayes::render::VolumeRenderer;
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_data::{Frame, FrameSplit, Part, Selection, Views};
use octobayes_session::{OpenedModel, image_settings};
use octobayes_show::export::surfaces;
use octobayes_show::plan_page::planned_cameras;
use octobayes_show::viewer::{Page, ShownSplats, ShownVolume, SplatsView, VolumeView, write_splats_view, write_volume};
use octobayes_splats::{SeenSplats, SplatRenderer, Splats};

/// Pixels looked at for the histogram, if the field holds no points on visible surfaces.
const PIXELS: u64 = 50_000;
/// Pixels of the training views that splats are ranked and coloured by.
const PIXELS_OF_SPLATS: u64 = 1_000_000;
/// Most cells along the longest edge, and bytes of the file, if no number of cells is given.
const MAX_DEFAULT_CELLS: u32 = 256;
const MAX_DEFAULT_BYTES: usize = 6_000_000;
/// Most bytes of a file of splats: about a million of them.
const MAX_SPLATS_BYTES: usize = 32_000_000;

/// Write a viewer: one HTML file that opens from disk in any browser
///
/// Shows a volume or Gaussian splats, which you turn with mouse, fingers or keys: log10 U beside colour, depth, colour
/// tinted by U. A slider removes what is uncertain, a switch what no training ray reached. The training cameras can be
/// shown and stepped through; the pointer reads position, U and depth. Two clicks measure a length, with its deviation if
/// the field is of `uncertainty --for depth`. The file holds everything and needs no server.
///
/// A volume is shown as a regular lattice: detail finer than a cell is averaged. Splats are drawn one by one. Colour
/// does not depend on direction.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    octobayes view lego.safetensors lego.oct -o lego.html\n  \
    octobayes view scene.ply scene.oct --cameras cameras.json -o scene.html")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// Uncertainty of the model
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    unit: UnitOptions,

    /// Show the cameras of a plan, too: the page or the camera file (--chosen) of `next-view`
    #[arg(long, value_name = "PLAN.html|CAMERAS.json", help_heading = heading::INPUT)]
    plan: Option<PathBuf>,

    /// File to write, `.html`
    #[arg(short, long, value_name = "VIEW.html", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Cells of a volume along the longest edge of the model's box, or of contracted space [default: as many as fit
    /// into 6 MB, at most 256]
    #[arg(
        long,
        value_name = "N",
        value_parser = count::<u32>(32..=1024),
        help_heading = heading::OUTPUT,
    )]
    cells: Option<u32>,

    /// Ends of the colour bar of log10 U [default: as in render]
    #[arg(
        long,
        value_name = "LOW,HIGH",
        value_parser = parse_range,
        allow_hyphen_values = true,
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    range: Option<[f64; 2]>,

    /// Use the field even if it was computed for another model
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    force: bool,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        self.cameras.find(Part::Training);
        if self.output.extension().is_none_or(|e| e != "html") {
            return Err(Error::extension(&self.output, "`.html`"));
        }
        self.files().check()?;
        let field = open_field(&self.field)?;
        let opened = OpenedModel::of_field(&field, &self.field, &self.model.model, self.force, &mut tell)?;
        let said = match Splats::of(&*opened.model) {
            Some(splats) => self.of_splats(splats, &opened.name, &field, bars)?,
            None => self.of_volume(&opened, &field, bars)?,
        };
        say!("{}: {said}", self.output.display())
    }

    /// What lengths are written in, and its name.
    fn unit(&self) -> (f64, &'static str) {
        let unit = self.unit.unit();
        (unit.factor, unit.name())
    }

    /// The cameras of the plan.
    fn planned(&self) -> Result<Vec<Frame>> {
        let Some(path) = &self.plan else { return Ok(Vec::new()) };
        if path.extension().is_none_or(|extension| extension != "html") {
            return Ok(Views::read(path, None)?.frames);
        }
        let bytes = octobayes::io::read(path)?;
        let page = String::from_utf8_lossy(&bytes);
        let expected = "a plan, which `next-view -o PLAN.html` writes";
        let cameras = planned_cameras(&page).ok_or_else(|| Error::malformed(path, "page", expected, "another page"))?;
        let folder = tempfile::tempdir().map_err(Error::io(path, "cannot unpack its cameras"))?;
        let file = folder.path().join("transforms.json");
        std::fs::write(&file, cameras).map_err(Error::io(path, "cannot unpack its cameras"))?;
        Ok(Views::read(&file, None)?.frames)
    }

    /// The files that are read and written.
    fn files(&self) -> CommandFiles {
        CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .inputs("--plan", &self.plan)
            .output("--output", &self.output)
    }

    /// Writes the page of a volume, and describes it.
    fn of_volume(&self, opened: &OpenedModel, field: &UncertaintyField, bars: &Bars) -> Result<String> {
        let settings = image_settings(field);
        let model = opened.volume()?;
        let views = self.cameras.read(Some(&*opened.model), &opened.name)?;
        self.files().images(&views).check()?;
        let offset = settings.offset_for(&*opened.model);
        let volume = VolumeRenderer { tracer: settings.tracer(model, 0.0, bars)?, differentiation: None };
        let tracer = &volume.tracer;
        let surface: Vec<Vec3> = if field.surface().is_empty() {
            let cameras: Vec<Camera> = views.frames.iter().map(|frame| frame.camera).collect();
            surfaces(&volume, &cameras, offset, PIXELS, bars)?.positions
        } else {
            stored_surface(field)
        };
        let page = Page {
            field,
            frames: &views.frames,
            planned: &self.planned()?,
            offset,
            background: tracer.background,
            surface: &surface,
            range: bar_of(&BakedField::unbaked(field), self.range),
            title: &title(&opened.name),
            unit: self.unit(),
        };
        let view = VolumeView { model, tracer, page };
        let (cells, budget) = self.cells.map_or((MAX_DEFAULT_CELLS, MAX_DEFAULT_BYTES), |cells| (cells, usize::MAX));
        let ShownVolume { cells, bytes, bricks } = write_volume(&self.output, &view, cells, budget, bars)?;
        let bytes = report::bytes(bytes);
        Ok(format!("{bytes}, {cells} cells along the longest edge, {bricks} bricks with matter"))
    }

    /// Writes the page of splats, and describes it.
    fn of_splats(&self, splats: &Splats, name: &str, field: &UncertaintyField, bars: &Bars) -> Result<String> {
        if let Some(cells) = self.cells {
            let expected = "a volume: splats are not cut into cells";
            return Err(Error::setting("--cells", expected, format!("{cells} for splats")));
        }
        let settings = image_settings(field);
        let offset = settings.offset_for(splats);
        let frames = self.training_frames()?;
        let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
        let renderer = SplatRenderer::new(splats, settings.background);
        let measure = || SeenSplats::measure(&renderer, &cameras, offset, PIXELS_OF_SPLATS, bars);
        let seen = (!cameras.is_empty()).then(measure).transpose()?;
        let surface = stored_surface(field);
        let page = Page {
            field,
            frames: &frames,
            planned: &self.planned()?,
            offset,
            background: settings.background,
            surface: if surface.is_empty() { splats.means() } else { &surface },
            range: bar_of(&BakedField::unbaked(field), self.range),
            title: &title(name),
            unit: self.unit(),
        };
        let view = SplatsView { splats, seen: seen.as_ref(), page };
        let ShownSplats { count, visible, share, bytes } = write_splats_view(&self.output, &view, MAX_SPLATS_BYTES)?;
        if count < visible {
            let of_what = if seen.is_some() { "of what the training views show" } else { "of opacity times area" };
            announce!(
                "note: {count} of {visible} splats fit into {}; they make up {:.1} % {of_what}",
                report::bytes(MAX_SPLATS_BYTES),
                100.0 * share
            );
        }
        Ok(format!("{}, {count} of {} splats", report::bytes(bytes), splats.len()))
    }

    /// The training frames of the camera file; none without one, because splats store no cameras.
    fn training_frames(&self) -> Result<Vec<Frame>> {
        if self.cameras.cameras.is_none() {
            announce!(
                "note: without --cameras, the page has no training cameras, and colours are means over all directions"
            );
            return Ok(Vec::new());
        }
        let views = self.cameras.read(None, "splats")?;
        self.files().images(&views).check()?;
        FrameSplit::new(views).select(Part::Training, &Selection::All, |_| true)
    }
}

/// The points on visible surfaces that a field stores.
fn stored_surface(field: &UncertaintyField) -> Vec<Vec3> {
    field.surface().iter().copied().map(Vec3::from_array).collect()
}

/// The model's name without its folder.
fn title(name: &str) -> String {
    Path::new(name).file_name().map_or_else(|| name.into(), |name| name.to_string_lossy().into_owned())
}
