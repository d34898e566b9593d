//! `export`: files for other people's tools.

use std::path::{Path, PathBuf};

use super::belongs::check_field;
use super::files::CommandFiles;
use super::opened::OpenedField;
use super::options::{CameraOptions, MOST_KEPT, ModelOptions, RayOptions, Threshold, UTF_8, count, parse_positive};
use super::progress::Bars;
use crate::dataset::{Part, Views};
use crate::export::{
    MeshSettings, Surfaces, surfaces, write_hyper_tree, write_leaves, write_mesh, write_points, write_report,
};
use crate::field::RadianceField;
use crate::geometry::{Camera, Domain};
use crate::uncertainty::ThresholdedField;
use crate::{Error, Result};

/// Write a field for other tools: NumPy, ParaView, CloudCompare, MeshLab, Blender, spreadsheets
///
/// The extension of FILE says what is written. Of the field alone:
///
///   .npz  its leaves: centre, edge, level, log10 U, rays, what was seen, 3x3 covariance
///   .htg  the octree as VTK hyper tree grid (ParaView): log10 U, level, rays
///
/// With the model and its training cameras:
///
///   .ply  points on the surfaces that the cameras see: colour, normal, log10 U, sigma, rays
///   .ply  with --mesh, the surface as triangles with the same
///   .csv  per camera and per region: share of surfaces never seen, quantiles of sigma
///
/// sigma is U, one standard deviation; in scene units for a field of `--scale data`.
#[derive(clap::Args)]
#[command(
    verbatim_doc_comment,
    override_usage = "octobayes export [OPTIONS] --output <FILE> [MODEL] <FIELD.oct>",
    after_help = "Examples:\n  \
    octobayes export lego.oct -o lego.htg\n  \
    octobayes export lego.safetensors lego.oct --mesh --threshold 99% -o lego.ply"
)]
pub struct Args {
    /// The field; before it, for `.ply` and `.csv`, the model that it was computed from
    #[arg(value_names = ["MODEL", "FIELD.oct"], num_args = 1..=2, required = true)]
    names: Vec<PathBuf>,

    /// File to write: `.npz`, `.htg`, `.ply` or `.csv`
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    #[command(flatten)]
    rays: RayOptions,

    /// Pixels to look at, spread over all cameras, for points and report
    #[arg(long, value_name = "N", default_value_t = 400_000, value_parser = count::<u64>(1..=MOST_KEPT))]
    pixels: u64,

    /// Add the axes of the covariance at every point, as long as one standard deviation; the field must keep its sums
    #[arg(long)]
    ellipsoids: bool,

    /// Write the surface as a mesh instead of points
    #[arg(long, conflicts_with = "ellipsoids")]
    mesh: bool,

    /// Cells of the mesh along the longest edge of the model's box
    #[arg(
        long,
        value_name = "N",
        default_value_t = 192,
        value_parser = clap::value_parser!(u32).range(8..=640),
        requires = "mesh",
    )]
    cells: u32,

    /// Density on the surface of the mesh, 1 / scene unit [default: what absorbs half of the light along a cell's edge]
    #[arg(long, value_name = "SIGMA", value_parser = parse_positive, requires = "mesh")]
    density: Option<f64>,

    /// First remove density where log10 U exceeds this, or, as `99%`, what it exceeds on the most certain 99 percent of
    /// visible surfaces
    #[arg(long, value_name = "LOG10_U|PERCENT%", value_parser = Threshold::parse, allow_hyphen_values = true)]
    threshold: Option<Threshold>,

    /// Use the field even if it was computed for another model
    #[arg(long)]
    force: bool,
}

/// What is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Leaves,
    HyperTree,
    Points,
    Mesh,
    Report,
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, bars: &Bars) -> Result<()> {
        let kind = self.kind()?;
        let (model, path) = self.model_and_field()?;
        self.cameras.find(Part::Training);
        CommandFiles::default()
            .input("FIELD", &path)
            .inputs("MODEL", &model)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output)
            .check()?;
        let field = OpenedField::open(&path)?;
        let facts = field.facts();
        match (kind, model) {
            (Kind::Leaves, _) => {
                let matrices = facts.sums().map(|_| facts.matrices(facts.protocol().covariance)).transpose()?;
                write_leaves(&self.output, field.space(), matrices.as_ref())?;
            }
            (Kind::HyperTree, _) => {
                if let Domain::Contracted { radius, .. } = facts.lattice().domain() {
                    announce!(
                        "note: a contracted domain is written as its cube: {radius} scene units around the centre are \
                         unchanged, the rest of space is folded around them"
                    );
                }
                write_hyper_tree(&self.output, field.space())?;
            }
            (_, Some(model)) => self.with_model(kind, model, &path, &field, bars)?,
            (_, None) => {
                let expected = "a model beside the field, for surfaces";
                return Err(Error::setting("MODEL", expected, "none"));
            }
        }
        say!("{}", self.output.display())
    }

    /// The model, if there is one, and the field.
    fn model_and_field(&self) -> Result<(Option<String>, PathBuf)> {
        match &self.names[..] {
            [model, field] => {
                let is_field = |path: &Path| path.extension().is_some_and(|e| e == "oct") || path.is_dir();
                if is_field(model) && !is_field(field) {
                    let expected = "the model before the field: `export MODEL FIELD.oct`";
                    return Err(Error::setting("MODEL", expected, model.display().to_string()));
                }
                let refused = || Error::setting("MODEL", UTF_8, model.display().to_string());
                Ok((Some(model.to_str().ok_or_else(refused)?.into()), field.clone()))
            }
            names => Ok((None, names.iter().collect())),
        }
    }

    /// What the options ask for.
    fn kind(&self) -> Result<Kind> {
        let kind = match (self.output.extension().and_then(|e| e.to_str()), self.mesh) {
            (Some("npz"), _) => Kind::Leaves,
            (Some("htg"), _) => Kind::HyperTree,
            (Some("ply"), false) => Kind::Points,
            (Some("ply"), true) => Kind::Mesh,
            (Some("csv"), _) => Kind::Report,
            _ => {
                let expected = "`.npz`, `.htg`, `.ply` or `.csv`";
                return Err(Error::malformed(&self.output, "file name", expected, "another extension"));
            }
        };
        let is_of_field = matches!(kind, Kind::Leaves | Kind::HyperTree);
        let alone = [
            ("--mesh", self.mesh && kind != Kind::Mesh, "a mesh only in a `.ply`"),
            ("--ellipsoids", self.ellipsoids && kind != Kind::Points, "ellipsoids only with points in a `.ply`"),
            ("--threshold", is_of_field && self.threshold.is_some(), "surfaces to clean, in a `.ply` or `.csv`"),
            ("--cameras", is_of_field && self.cameras.cameras.is_some(), "cameras only for a `.ply` or `.csv`"),
        ];
        match alone.into_iter().find(|(_, is_wrong, _)| *is_wrong) {
            Some((option, _, expected)) => Err(Error::setting(option, expected, self.output.display().to_string())),
            None => Ok(kind),
        }
    }

    /// Writes what needs the model.
    fn with_model(&self, kind: Kind, model: String, path: &Path, field: &OpenedField, bars: &Bars) -> Result<()> {
        let options = ModelOptions { model, rays: self.rays };
        let model = options.open()?;
        check_field(path, field.facts(), &options, &*model, self.force)?;
        let threshold = self.threshold.map(|threshold| threshold.log10(field.space())).transpose()?;
        let cleaned = threshold.map(|threshold| ThresholdedField::new(&*model, field.space(), threshold));
        if self.threshold.is_some() {
            // Reads every tile once, before any work: what cannot be read would count as removed.
            field.space().surface()?;
        }
        let check = || cleaned.as_ref().map_or(Ok(()), ThresholdedField::check);
        let shown: &dyn RadianceField = cleaned.as_ref().map_or(&*model, |cleaned| cleaned);
        if kind == Kind::Mesh {
            let settings = MeshSettings { resolution: self.cells, density: self.density };
            let [vertices, triangles] = write_mesh(&self.output, shown, field.space(), settings, bars)?;
            check()?;
            announce!("note: {vertices} vertices, {triangles} triangles");
            return Ok(());
        }
        let views = self.cameras.read(&*model, &options.model)?;
        CommandFiles::default().images(&views).output("--output", &self.output).check()?;
        let found = self.surfaces(&options, shown, &views, bars)?;
        check()?;
        if kind == Kind::Report {
            let names: Vec<String> = views.frames.into_iter().map(|frame| frame.name).collect();
            return write_report(&self.output, &found, &names, field.space());
        }
        announce!("note: {} points", found.positions.len());
        let facts = field.facts();
        let matrices = self.ellipsoids.then(|| facts.matrices(facts.protocol().covariance)).transpose()?;
        write_points(&self.output, &found, field.space(), matrices.as_ref())
    }

    /// The surfaces that the cameras see.
    fn surfaces(
        &self,
        options: &ModelOptions,
        shown: &dyn RadianceField,
        views: &Views,
        bars: &Bars,
    ) -> Result<Surfaces> {
        let settings = options.image_settings();
        let offset = settings.offset_for(shown);
        let tracer = settings.tracer(shown, 0.0, bars)?;
        let cameras: Vec<Camera> = views.frames.iter().map(|frame| frame.camera).collect();
        surfaces(&tracer, &cameras, offset, self.pixels, bars)
    }
}
