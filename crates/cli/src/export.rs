//! `export`: files for other people's tools.

use std::path::{Path, PathBuf};

use super::files::CommandFiles;
use super::given::Given;
use super::options::{CameraOptions, MAX_KEPT_COUNT, OfficialOptions, UTF_8, count, heading, parse_positive};
use super::progress::Bars;
use super::report;
use super::streams::tell;
use octobayes::estimate::{Model, RaySettings};
use octobayes::geometry::{Camera, Domain};
use octobayes::uncertainty::{BakedField, UncertaintyField};
use octobayes::{Error, Result};
use octobayes_clean::Evidence;
use octobayes_data::write_official;
use octobayes_data::{FrameSplit, Part, Selection, Views};
use octobayes_session::{OpenedModel, Threshold, image_settings};
use octobayes_show::export::{
    MeshSettings, Surfaces, surfaces, write_hyper_tree, write_leaves, write_mesh, write_points, write_report,
    write_splats,
};
use octobayes_splats::Splats;

/// Write a field for other tools: NumPy, ParaView, CloudCompare, Blender, spreadsheets, the official code
///
/// The extension of FILE selects what is written. Of the field alone:
///
///   .npz  its leaves: centre, edge, level, log10 U, rays, what was seen, 3x3 covariance
///   .htg  the octree as VTK hyper tree grid (ParaView): log10 U, level, rays
///   .npy  the official code's grid: (2^level + 1)^3 sums of squared derivatives in f32, in its index order
///   .oct  the field without the 3x3 matrices that --keep-sums kept; or a field of the official code's .npy
///
/// With the model and its training cameras:
///
///   .ply  of splats: the splats with columns uncertainty, log10_uncertainty, seen and, with --cameras, weight and
///         views; with --threshold only those that stay
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
    octobayes export unc.npy -o unc.oct --box=-1,-1,-1,1,1,1\n  \
    octobayes export lego.safetensors lego.oct --mesh --threshold 99% -o lego.ply\n  \
    octobayes export scene.ply scene.oct --cameras cameras.json -o scene-u.ply"
)]
pub struct Args {
    /// The field; before it, for `.ply` and `.csv`, the model that it was computed from
    #[arg(value_names = ["MODEL", "FIELD.oct"], num_args = 1..=2, required = true)]
    names: Vec<PathBuf>,

    /// File to write: `.npz`, `.htg`, `.ply` or `.csv`
    #[arg(short, long, value_name = "FILE", help_heading = heading::OUTPUT)]
    output: PathBuf,

    #[command(flatten)]
    cameras: CameraOptions,

    /// Pixels to look at, spread over all cameras, for points and report
    #[arg(
        long,
        value_name = "N",
        default_value_t = Surfaces::PIXELS,
        value_parser = count::<u64>(1..=MAX_KEPT_COUNT),
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    pixels: u64,

    /// Add the axes of the covariance at every point, as long as one standard deviation; the field must keep its sums
    #[arg(long, help_heading = heading::OUTPUT, hide_short_help = true)]
    ellipsoids: bool,

    /// Write the surface as a mesh instead of points
    #[arg(long, conflicts_with = "ellipsoids", help_heading = heading::OUTPUT)]
    mesh: bool,

    /// Cells of the mesh along the longest edge of the model's box
    #[arg(
        long,
        value_name = "N",
        default_value_t = MeshSettings::default().resolution,
        value_parser = count::<u32>(8..=640),
        requires = "mesh",
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    cells: u32,

    /// Density on the surface of the mesh, 1 / scene unit [default: what absorbs half of the light along a cell's edge]
    #[arg(
        long,
        value_name = "SIGMA",
        value_parser = parse_positive,
        requires = "mesh",
        help_heading = heading::OUTPUT,
        hide_short_help = true,
    )]
    density: Option<f64>,

    /// First remove density where log10 U exceeds this, or, as `99%`, what it exceeds on the most certain 99 percent of
    /// visible surfaces
    #[arg(
        long,
        value_name = "LOG10_U|PERCENT%",
        value_parser = Threshold::parse,
        allow_hyphen_values = true,
        help_heading = heading::OUTPUT,
    )]
    threshold: Option<Threshold>,

    /// Use the field even if it was computed for another model
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    force: bool,

    #[command(flatten)]
    official: OfficialOptions,
}

/// Options of the cameras that see surfaces.
const OF_CAMERAS: [&str; 4] = ["--cameras", "--fov", "--resolution", "--pixels"];

/// What is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Field,
    Official,
    Leaves,
    HyperTree,
    Points,
    Mesh,
    Report,
}

impl Kind {
    /// Whether it needs no model.
    fn is_of_field(self) -> bool {
        matches!(self, Self::Field | Self::Official | Self::Leaves | Self::HyperTree)
    }
}

impl Args {
    /// Runs the verb.
    pub fn run(mut self, given: &Given, bars: &Bars) -> Result<()> {
        let kind = self.kind(given)?;
        if !matches!(kind, Kind::Field | Kind::Official) {
            bars.listen();
        }
        let (model, path) = self.model_and_field()?;
        if let Some(model) = model.as_ref().filter(|_| kind.is_of_field()) {
            let found = format!("{model} for {}", self.output.display());
            return Err(Error::setting("MODEL", "the field alone, for all but `.ply` and `.csv`", found));
        }
        self.cameras.find(Part::Training);
        CommandFiles::default()
            .input("FIELD", &path)
            .inputs("MODEL", &model)
            .cameras(self.cameras.cameras.as_deref())
            .output("--output", &self.output)
            .check()?;
        self.official.check(&path)?;
        let field = self.official.open(&path)?;
        match (kind, model) {
            (Kind::Field, _) => {
                let field = field.for_queries();
                field.write(&self.output)?;
                return say!("{}: {}", self.output.display(), report::summary(&field.summary()));
            }
            (Kind::Official, _) => {
                write_official(&field, &self.output)?;
                let (rays, lambda) = (field.record().rays, field.record().lambda);
                return say!(
                    "{}: Σ tr(JᵀJ) of {rays} rays; uncertainty there is log10 of sqrt(1 / (Σ/{rays} + {lambda:e}))",
                    self.output.display()
                );
            }
            (Kind::Leaves, _) => {
                let matrices = field.sums().map(|_| field.matrices(field.record().covariance)).transpose()?;
                write_leaves(&self.output, &field, matrices.as_ref())?;
            }
            (Kind::HyperTree, _) => {
                if let Domain::Contracted { radius, .. } = field.lattice().domain() {
                    announce!(
                        "note: a contracted domain is written as its cube: {radius} scene units around the centre are \
                         unchanged, the rest of space is folded around them"
                    );
                }
                write_hyper_tree(&self.output, &field)?;
            }
            (_, Some(model)) => self.with_model(kind, &model, &path, &field, bars)?,
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
                let is_field = |path: &Path| path.extension().is_some_and(|e| e == "oct" || e == "npy");
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

    /// The export that the options select.
    fn kind(&self, given: &Given) -> Result<Kind> {
        let kind = match (self.output.extension().and_then(|e| e.to_str()), self.mesh) {
            (Some("oct"), _) => Kind::Field,
            (Some("npy"), _) => Kind::Official,
            (Some("npz"), _) => Kind::Leaves,
            (Some("htg"), _) => Kind::HyperTree,
            (Some("ply"), false) => Kind::Points,
            (Some("ply"), true) => Kind::Mesh,
            (Some("csv"), _) => Kind::Report,
            _ => {
                let expected = "`.npz`, `.htg`, `.npy`, `.oct`, `.ply` or `.csv`";
                return Err(Error::extension(&self.output, expected));
            }
        };
        let found = || self.output.display().to_string();
        if self.mesh && kind != Kind::Mesh {
            return Err(Error::setting("--mesh", "a mesh only in a `.ply`", found()));
        }
        if kind != Kind::Points {
            given.refuse(&["--ellipsoids"], "ellipsoids only with points in a `.ply`", found())?;
        }
        if kind.is_of_field() {
            given.refuse(&["--threshold"], "surfaces to clean, in a `.ply` or `.csv`", found())?;
            given.refuse(&["--force"], "a model beside the field, for a `.ply` or `.csv`", found())?;
        }
        if kind.is_of_field() || kind == Kind::Mesh {
            let found = if kind == Kind::Mesh { "--mesh".into() } else { found() };
            given.refuse(&OF_CAMERAS, "points in a `.ply`, or a `.csv`: what cameras see", found)?;
        }
        Ok(kind)
    }

    /// Writes what needs the model.
    fn with_model(&self, kind: Kind, model: &str, path: &Path, field: &UncertaintyField, bars: &Bars) -> Result<()> {
        let opened = OpenedModel::of_field(field, path, model, self.force, &mut tell)?;
        let settings = image_settings(field);
        if let Some(splats) = Splats::of(&*opened.model) {
            return self.of_splats(kind, splats, settings, field, bars);
        }
        let model = &*opened.model;
        let unbaked = BakedField::unbaked(field);
        let threshold = self.threshold.map(|threshold| threshold.log10(&unbaked, &mut tell)).transpose()?;
        let part = threshold.map(|threshold| model.certain_part(&unbaked, threshold)).transpose()?.flatten();
        let shown = part.as_deref().unwrap_or(model);
        if kind == Kind::Mesh {
            let mesh = MeshSettings { resolution: self.cells, density: self.density };
            let volume = octobayes_models::volume(shown, &opened.name)?;
            let [vertices, triangles] = write_mesh(&self.output, volume, field, mesh, bars)?;
            announce!("note: {vertices} vertices, {triangles} triangles");
            return Ok(());
        }
        let views = self.cameras.read(Some(model), &opened.name)?;
        CommandFiles::default().images(&views).output("--output", &self.output).check()?;
        let found = self.surfaces(settings, model, shown, &views, bars)?;
        if kind == Kind::Report {
            let names: Vec<String> = views.frames.into_iter().map(|frame| frame.name).collect();
            return write_report(&self.output, &found, &names, field);
        }
        announce!("note: {} points", found.positions.len());
        let matrices = self.ellipsoids.then(|| field.matrices(field.record().covariance)).transpose()?;
        write_points(&self.output, &found, field, matrices.as_ref())
    }

    /// Writes splats with their uncertainty.
    fn of_splats(
        &self,
        kind: Kind,
        splats: &Splats,
        settings: RaySettings,
        field: &UncertaintyField,
        bars: &Bars,
    ) -> Result<()> {
        if kind != Kind::Points || self.ellipsoids {
            let expected = "a `.ply` of the splats themselves: meshes, reports and ellipsoids are of volumes' surfaces";
            let found = if self.ellipsoids { "--ellipsoids".into() } else { self.output.display().to_string() };
            return Err(Error::setting("export of splats", expected, found));
        }
        let unbaked = BakedField::unbaked(field);
        let threshold = self.threshold.map(|threshold| threshold.log10(&unbaked, &mut tell)).transpose()?;
        let seen = match &self.cameras.cameras {
            Some(_) => {
                let views = self.cameras.read(None, "splats")?;
                CommandFiles::default().images(&views).output("--output", &self.output).check()?;
                let frames = FrameSplit::new(views).select(Part::Training, &Selection::All, |_| true)?;
                let cameras: Vec<Camera> = frames.iter().map(|frame| frame.camera).collect();
                Some(Evidence::measure(splats, &cameras, settings.offset_for(splats), self.pixels, bars)?)
            }
            None => {
                announce!("note: without --cameras, the columns weight, views and front_share are left out");
                None
            }
        };
        let left = write_splats(&self.output, splats, field, seen.as_ref(), threshold)?;
        announce!("note: {left} of {} splats", splats.len());
        Ok(())
    }

    /// The surfaces that the cameras see.
    fn surfaces(
        &self,
        settings: RaySettings,
        whole: &dyn Model,
        shown: &dyn Model,
        views: &Views,
        bars: &Bars,
    ) -> Result<Surfaces> {
        let offset = settings.offset_for(whole);
        let renderer = shown.for_images(&settings, bars)?;
        let cameras: Vec<Camera> = views.frames.iter().map(|frame| frame.camera).collect();
        surfaces(&*renderer, &cameras, offset, self.pixels, bars)
    }
}
