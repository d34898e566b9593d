//! `view`: a viewer in one file.

use std::path::{Path, PathBuf};

use glam::Vec3;

use super::files::CommandFiles;
use super::opened::OpenedField;
use super::options::{CameraOptions, ModelArgument, heading, parse_range};
use super::progress::Bars;
use super::render::bar_of;
use super::report;
use super::streams::tell;
use crate::dataset::Part;
use crate::export::surfaces;
use crate::geometry::Camera;
use crate::session::{OpenedModel, image_settings};
use crate::viewer::{Shown, View, write_view};
use crate::{Error, Result};

/// Pixels looked at for the histogram, if the field holds no points on visible surfaces.
const PIXELS: u64 = 50_000;
/// Most cells along the longest edge, and bytes of the file, if no number of cells is given.
const MAX_DEFAULT_CELLS: u32 = 256;
const MAX_DEFAULT_BYTES: usize = 6_000_000;

/// Write a viewer: one HTML file that opens from disk in any browser
///
/// Shows the model as a volume that you turn with mouse, fingers or keys: log10 U beside colour, depth, colour tinted
/// by U. A slider removes what is uncertain, a switch what no training ray reached. The training cameras can be shown
/// and stepped through; the pointer reads position, U, rays, density and depth. The file holds everything and asks no
/// server.
///
/// The volume is a regular lattice: detail finer than a cell is averaged, and colour does not depend on direction.
#[derive(clap::Args)]
#[command(after_help = "Example: octobayes view lego.safetensors lego.oct -o lego.html")]
pub struct Args {
    #[command(flatten)]
    model: ModelArgument,

    /// Uncertainty of the model
    #[arg(value_name = "FIELD.oct")]
    field: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    /// File to write, `.html`
    #[arg(short, long, value_name = "VIEW.html", help_heading = heading::OUTPUT)]
    output: PathBuf,

    /// Cells of the volume along the longest edge of the model's box, or of contracted space [default: as many as fit
    /// into 6 MB, at most 256]
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(32..=1024),
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
        let files = CommandFiles::default()
            .input("MODEL", &self.model.model)
            .input("FIELD", &self.field)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output);
        files.check()?;
        let field = OpenedField::open(&self.field)?.whole()?;
        let opened = OpenedModel::of_field(&field, &self.field, &self.model.model, self.force, &mut tell)?;
        let model = opened.volume()?;
        let settings = image_settings(&field);
        let views = self.cameras.read(Some(&**model), &opened.name)?;
        files.images(&views).check()?;

        let offset = settings.offset_for(&**model);
        let tracer = settings.tracer(&**model, 0.0, bars)?;
        let surface: Vec<Vec3> = if field.surface().is_empty() {
            let cameras: Vec<Camera> = views.frames.iter().map(|frame| frame.camera).collect();
            surfaces(&tracer, &cameras, offset, PIXELS, bars)?.positions
        } else {
            field.surface().iter().copied().map(Vec3::from_array).collect()
        };
        let name = &opened.name;
        let path = Path::new(name);
        let title = path.file_name().map_or_else(|| name.clone(), |name| name.to_string_lossy().into_owned());
        let view = View {
            model: &**model,
            field: &field,
            tracer: &tracer,
            frames: &views.frames,
            offset,
            surface: &surface,
            range: bar_of(&field, self.range)?,
            title: &title,
        };
        let (cells, budget) = self.cells.map_or((MAX_DEFAULT_CELLS, MAX_DEFAULT_BYTES), |cells| (cells, usize::MAX));
        let Shown { cells, bytes, bricks } = write_view(&self.output, &view, cells, budget, bars)?;
        let bytes = report::bytes(bytes);
        say!("{}: {bytes}, {cells} cells along the longest edge, {bricks} bricks with matter", self.output.display())
    }
}
