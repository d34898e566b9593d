//! What a field covers, how fine it is, how information becomes a field, and what the file keeps.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::DVec3;

use super::numbers::{MOST, MOST_KEPT, count};
use super::parse::{numbers, parse_box, parse_bytes, parse_non_negative, parse_positive, parse_tile};
use super::scale::{ScaleOptions, TrainingPixels};
use crate::cli::opened::OpenedField;
use crate::cli::report::{self, Cost};
use crate::estimate::{GridKind, GridSettings};
use crate::geometry::{Aabb, Domain, MAX_LEVEL, Norm};
use crate::octree::Tile;
use crate::posterior::{Covariance, Criterion, Prior};
use crate::uncertainty::{OfficialGrid, UncertaintyField};
use crate::{Error, Result};

impl ValueEnum for Covariance {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let help = match self {
            Self::Diagonal => "sum of 1/H_kk: the paper's; depends on how the axes are turned",
            Self::Trace => "1/(tr S/R + lambda): the official code's",
            Self::Block => "trace of the inverse 3x3 block: does not depend on the axes",
        };
        Some(clap::builder::PossibleValue::new(self.name()).help(help))
    }
}

/// Fewer rays per vertex than this gain from pooling (`experiments/pooling.md`).
const FEW_RAYS: u64 = 4;

/// The part of space that a field covers.
#[derive(Args)]
pub struct DomainOptions {
    /// Box of the field: x0,y0,z0,x1,y1,z1 in scene units [default: the space that the model covers, which may be
    /// contracted]
    #[arg(
        long = "box",
        value_name = "BOX",
        value_parser = parse_box,
        allow_hyphen_values = true,
        conflicts_with = "contract",
    )]
    pub bounds: Option<Aabb>,

    /// Cover all of space, contracted outside --inner as in mip-NeRF 360; for unbounded scenes
    #[arg(long, value_enum, value_name = "NORM", requires = "inner")]
    pub contract: Option<Norm>,

    /// Centre and radius of the part that is not contracted: x,y,z,r in scene units
    #[arg(long, value_name = "BALL", value_parser = numbers::<4>, allow_hyphen_values = true, requires = "contract")]
    pub inner: Option<[f64; 4]>,
}

impl DomainOptions {
    /// What the options say, or else the space that the model covers. Says so on stderr if that is contracted.
    pub fn domain(&self, model: Option<Domain>) -> Result<Domain> {
        match (self.contract, self.inner, self.bounds.map(Domain::Box).or(model)) {
            (Some(norm), Some([x, y, z, radius]), _) => Domain::contracted(DVec3::new(x, y, z), radius, norm),
            (.., Some(domain)) => {
                if matches!(domain, Domain::Contracted { .. }) {
                    announce!("note: the field covers what the model does, {domain} (--box for a box)");
                }
                Ok(domain)
            }
            _ => Err(Error::setting("--box", "the box of the field, or --contract and --inner", "neither")),
        }
    }
}

/// How information becomes a field.
#[derive(Args)]
pub struct GridOptions {
    /// Where to write the field
    #[arg(short, long, value_name = "FIELD.oct")]
    pub output: PathBuf,

    /// Finest level, 1 to 16: 2^level cells per axis
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=16))]
    pub level: u8,

    /// Edge of the finest cells in scene units, instead of --level; rounded to the next finer level
    #[arg(long, value_name = "LENGTH", value_parser = parse_positive, conflicts_with = "level")]
    pub cell_size: Option<f64>,

    /// Most memory for the whole process, e.g. 2GiB; refinement that the fewest rays support is given up first
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    pub memory: Option<u64>,

    /// Where to refine the octree; several criteria are separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_value = "sensitivity")]
    pub refine: Vec<Criterion>,

    /// Structure that carries the field
    #[arg(long, value_enum, default_value = "octree")]
    pub grid: GridKind,

    /// Scalar read off the 3x3 matrices
    #[arg(long, value_enum, default_value = "diagonal")]
    pub covariance: Covariance,

    /// Prior precision, 1 / scene unit^2 [default: 1e-4 / 2^(3 level) per squared longest edge of the box]
    #[arg(long, value_name = "LAMBDA", value_parser = parse_positive)]
    pub lambda: Option<f64>,

    #[command(flatten)]
    pub scale: ScaleOptions,

    /// Largest change of log10 U that coarse leaves of the octree may cause; 0 keeps every vertex that any ray touched
    #[arg(long, value_name = "DECADES", default_value_t = 0.01, value_parser = parse_non_negative)]
    pub tolerance: f64,

    /// How the prior precision depends on the size of cells
    #[arg(long, value_enum, default_value = "uniform")]
    pub prior: Prior,

    /// Pool sums where rays are few: vertices whose neighbourhood has fewer rays than about this share what their
    /// neighbours saw; 0 leaves every vertex by itself, as in the paper
    #[arg(long, value_name = "RAYS", default_value_t = 0.0, value_parser = parse_non_negative)]
    pub min_rays: f64,

    /// Sum in part I of N of space only (I from 0; N = 2, 4, 8, ...), where the whole does not fit into memory; `merge`
    /// joins the parts to the same field
    ///
    /// Space is cut so that all tiles have about as many vertices. Each tile needs all rays that reach it, so N tiles
    /// take longer than one run, and a tile's file is as large as that of a shard.
    #[arg(long, value_name = "I/N", value_parser = parse_tile, conflicts_with = "memory")]
    pub tile: Option<Tile>,

    /// Keep the 3x3 matrices too: 28 bytes more a vertex. Other covariances, and `merge` with other seeds, need them
    #[arg(long)]
    pub keep_sums: bool,

    /// Points on visible surfaces to keep in the file, for `compare`
    #[arg(long, value_name = "N", default_value_t = 16_384, value_parser = count::<usize>(..=MOST_KEPT))]
    pub surface_points: usize,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

impl GridOptions {
    /// Checks that the output has the name of a field.
    pub fn check_output(&self) -> Result<()> {
        check_field_name(&self.output)
    }

    /// The library's settings for a field over `domain`.
    pub fn settings(&self, domain: &Domain, training: TrainingPixels) -> Result<GridSettings> {
        Ok(GridSettings {
            grid: self.grid,
            level: self.level_over(domain)?,
            criteria: self.refine.iter().copied().collect(),
            memory: self.memory,
            covariance: self.covariance,
            lambda: self.lambda,
            scale: self.scale.scale(domain, training)?,
            tolerance: self.tolerance,
            prior: self.prior,
            min_rays: self.min_rays,
            surface_points: self.surface_points,
            tile: self.tile,
            keep_sums: self.keep_sums,
        })
    }

    fn level_over(&self, domain: &Domain) -> Result<u8> {
        let Some(size) = self.cell_size else { return Ok(self.level) };
        let longest = domain.size().max_element();
        if size >= longest {
            let expected = format!("less than {longest:e}, the longest edge of this domain");
            return Err(Error::setting("--cell-size", expected, format!("{size:e}")));
        }
        let level = (longest / size).log2().ceil().max(1.0);
        if level <= f64::from(MAX_LEVEL) {
            Ok(level as u8)
        } else {
            let least = longest / f64::from(1_u32 << MAX_LEVEL);
            Err(Error::setting(
                "--cell-size",
                format!("{least:e} or more, level {MAX_LEVEL} of this domain"),
                format!("{size:e}"),
            ))
        }
    }

    /// Writes a finished field and reports it.
    pub fn write(&self, field: &UncertaintyField, cost: &Cost) -> Result<()> {
        if let Some(median) = field.median_rays().filter(|&median| median < FEW_RAYS && self.min_rays == 0.0) {
            announce!(
                "note: half of the vertices that moved are supported by {median} rays or fewer; --min-rays 4 shares \
                 what their neighbours saw, more --rays is better"
            );
        }
        if let Some(tile) = field.tile().filter(|_| field.sums().is_some_and(|sums| sums.iter().all(|s| s.rays == 0))) {
            announce!("note: tile {tile} has no vertex that a ray touched: the scene is too small for so many tiles");
        }
        field.write(&self.output)?;
        report::finished(field, cost, self.json)
    }
}

/// Refuses names of files that would not be taken for a field.
pub fn check_field_name(output: &Path) -> Result<()> {
    if output.extension().is_some_and(|extension| extension == "oct") {
        return Ok(());
    }
    let expected = "`.oct` (`convert` writes `.npy` from it)";
    Err(Error::malformed(output, "file name", expected, "another extension"))
}

/// What an official `.npy` does not say: its box and its number of rays.
#[derive(Args)]
pub struct OfficialOptions {
    /// Box of the official code's `.npy` grids: x0,y0,z0,x1,y1,z1 in scene units
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub bounds: Option<Aabb>,

    /// Number of rays summed in the official code's `.npy` grids [default: 4096000]
    #[arg(long, value_parser = count::<u64>(1..=MOST))]
    pub rays: Option<u64>,
}

impl OfficialOptions {
    /// Reads a field: `.oct`, a folder of tiles, or the official code's `.npy`.
    pub fn read(&self, path: &Path) -> Result<UncertaintyField> {
        self.open(path)?.whole()
    }

    /// The same, but leaves tiles in their files.
    pub fn open(&self, path: &Path) -> Result<OpenedField> {
        match path.extension().and_then(|e| e.to_str()) {
            Some("npy") => {
                let bounds = self.bounds.ok_or_else(|| {
                    let found = format!("{} without one", path.display());
                    Error::setting("--box", "the box of the official grid, which its file does not name", found)
                })?;
                let rays = self.rays.unwrap_or_else(|| {
                    let rays = OfficialGrid::DEFAULT_RAYS;
                    announce!(
                        "note: {} is taken for sums of {rays} rays, the official default; --rays",
                        path.display()
                    );
                    rays
                });
                let grid = OfficialGrid { domain: Domain::Box(bounds), rays, lambda: None };
                Ok(OpenedField::Whole(Box::new(grid.read(path)?)))
            }
            _ => OpenedField::open(path),
        }
    }
}
