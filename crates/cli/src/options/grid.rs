//! What a field covers, how fine it is, how information becomes a field, and what the file keeps.

use std::path::Path;

use clap::Args;
use glam::DVec3;

use super::heading;
use super::numbers::{MAX_COUNT, count};
use super::parse::{choice, parse_box, parse_contraction, parse_non_negative, parse_positive};
use super::scale::ScaleOptions;
use crate::opened::open_field;
use octobayes::estimate::{GridKind, GridSettings};
use octobayes::geometry::{Aabb, Domain, Norm};
use octobayes::posterior::{Covariance, Pooling};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::OfficialGrid;
use octobayes_session::{Choices, Purpose};

/// The part of space that a field covers.
#[derive(Args)]
pub struct DomainOptions {
    /// The box that the field covers: x0,y0,z0,x1,y1,z1 in scene units [default: the model's own, or the space in which
    /// the cameras see splats]
    #[arg(
        long = "box",
        value_name = "BOX",
        value_parser = parse_box,
        allow_hyphen_values = true,
        conflicts_with = "contract",
        help_heading = heading::GRID,
    )]
    pub bounds: Option<Aabb>,

    /// Cover all of space, contracted outside a ball as in mip-NeRF 360; for unbounded scenes. NORM is l2 or linf, then
    /// come the ball's centre and radius in scene units
    #[arg(
        long,
        value_name = "NORM:X,Y,Z,R",
        value_parser = parse_contraction,
        help_heading = heading::GRID,
        hide_short_help = true,
    )]
    pub contract: Option<(Norm, [f64; 4])>,
}

impl DomainOptions {
    /// The domain of the options, if any is given.
    pub fn chosen(&self) -> Result<Option<Domain>> {
        match self.contract {
            Some((norm, [x, y, z, radius])) => Domain::contracted(DVec3::new(x, y, z), radius, norm).map(Some),
            None => Ok(self.bounds.map(Domain::Box)),
        }
    }
}

/// How information becomes a field.
#[derive(Args)]
pub struct GridOptions {
    /// What the field is for. Sets the options that this needs, unless they are given
    // A level for all models would be wrong for splats, so what is open stays open until the model is known.
    #[arg(long = "for", value_name = "GOAL", value_parser = choice::<Purpose>(), help_heading = heading::STATISTICS)]
    pub purpose: Option<Purpose>,

    /// Finest level L, 1 to 16: up to 2^L cells per axis. 6 is a quick look, 8 the paper's grid [default: 8; for splats
    /// 6, or 7 if there are more than 32768; or what --for sets]
    #[arg(long, value_parser = count::<u8>(1..=16), help_heading = heading::GRID)]
    pub level: Option<u8>,

    /// Structure that carries the field
    #[arg(
        long,
        value_parser = choice::<GridKind>(),
        default_value = GridKind::default().name(),
        help_heading = heading::GRID,
        hide_short_help = true,
    )]
    pub grid: GridKind,

    /// What U^2 is of a vertex's 3x3 Hessian H: the paper's sum of 1/H_kk (diagonal), the official code's 1/tr H
    /// (trace), or tr H^-1, which does not depend on the axes (block) [default: diagonal, or what --for sets]
    #[arg(long, value_parser = choice::<Covariance>(), help_heading = heading::STATISTICS, hide_short_help = true)]
    pub covariance: Option<Covariance>,

    /// Prior precision, 1 / scene unit^2 [default: 1e-4 / 2^(3 level) per squared longest edge of the box]
    #[arg(
        long,
        value_name = "LAMBDA",
        value_parser = parse_positive,
        help_heading = heading::ADVANCED,
        hide_short_help = true,
    )]
    pub lambda: Option<f64>,

    #[command(flatten)]
    pub scale: ScaleOptions,

    /// Largest change of log10 U that coarse leaves of the octree may cause; 0 keeps every vertex that any ray touched
    #[arg(
        long,
        value_name = "DECADES",
        default_value_t = GridSettings::default().tolerance,
        value_parser = parse_non_negative,
        help_heading = heading::GRID,
        hide_short_help = true,
    )]
    pub tolerance: f64,

    /// Whether vertices near few rays borrow from their neighbours. Where rays are few, it more than halves errors on
    /// surfaces, and raises them in the space beside
    #[arg(
        long,
        value_parser = choice::<Pooling>(),
        default_value = Pooling::default().name(),
        help_heading = heading::STATISTICS,
        hide_short_help = true,
    )]
    pub pooling: Pooling,

    /// Keep the 3x3 matrices too: 28 bytes more a vertex in the file, and 76 in memory. Other covariances, and `merge`
    /// with other seeds, need them
    #[arg(long, help_heading = heading::STATISTICS, hide_short_help = true)]
    pub keep_sums: bool,
}

impl GridOptions {
    /// The library's settings, but for those that [`GridOptions::choices`] decide on.
    pub fn settings(&self) -> GridSettings {
        let settings = GridSettings::default().grid(self.grid).lambda(self.lambda);
        settings.tolerance(self.tolerance).pooling(self.pooling)
    }

    /// What the purpose or the model decides on, where it is not given.
    pub fn choices(&self) -> Choices {
        Choices {
            purpose: self.purpose,
            level: self.level,
            covariance: self.covariance,
            scale: self.scale.scale,
            noise: self.scale.noise,
            keep_sums: self.keep_sums.then_some(true),
        }
    }
}

/// Refuses names of files that would not be taken for a field.
pub fn check_field_name(output: &Path) -> Result<()> {
    if output.extension().is_some_and(|extension| extension == "oct") {
        return Ok(());
    }
    let expected = "`.oct` (`export` writes `.npy` from it)";
    Err(Error::extension(output, expected))
}

/// What an official `.npy` lacks: its box and its number of rays.
#[derive(Args)]
pub struct OfficialOptions {
    /// Box of the official code's `.npy` grids: x0,y0,z0,x1,y1,z1 in scene units
    #[arg(
        long = "box",
        value_name = "BOX",
        value_parser = parse_box,
        allow_hyphen_values = true,
        help_heading = heading::INPUT,
        hide_short_help = true,
    )]
    pub bounds: Option<Aabb>,

    /// Number of rays summed in the official code's `.npy` grids [default: 4096000]
    #[arg(long, value_parser = count::<u64>(1..=MAX_COUNT), help_heading = heading::INPUT, hide_short_help = true)]
    pub rays: Option<u64>,
}

impl OfficialOptions {
    /// Refuses these options for a field that states both itself.
    pub fn check(&self, path: &Path) -> Result<()> {
        let given = [("--box", self.bounds.is_some()), ("--rays", self.rays.is_some())];
        match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((flag, _)) if !is_official(path) => {
                let expected = "a grid of the official code (`.npy`), which does not state it";
                Err(Error::setting(flag, expected, path.display().to_string()))
            }
            _ => Ok(()),
        }
    }

    /// Opens a field: `.oct`, or the official code's `.npy`.
    pub fn open(&self, path: &Path) -> Result<UncertaintyField> {
        match path {
            _ if is_official(path) => {
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
                grid.read(path)
            }
            _ => open_field(path),
        }
    }
}

/// Whether a file has the name of a grid of the official code.
fn is_official(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "npy")
}
