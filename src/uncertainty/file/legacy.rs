//! Fields of versions 1 and 2, whose headers are positional. Their content is frozen here.

use std::path::Path;

use half::f16;

use super::{Content, FORMAT, Header, Kind, Vertices};
use crate::geometry::Lattice;
use crate::io::container::Item;
use crate::io::legacy;
use crate::posterior::{Covariance, Criteria, Prior, Scale, VertexSums};
use crate::rays::{Deal, Pixels, Shard};
use crate::render::GradientMethod;
use crate::uncertainty::{Origin, Protocol, RayCounts};
use crate::{Error, Result};

/// The last positional version. Version 1 has no error bars.
const LAST: u32 = 2;
const SECTIONS: [&str; 7] = ["masks", "deviations", "sums", "surface", "logs", "limits", "errors"];

#[derive(serde::Deserialize)]
struct OldHeader {
    protocol: OldProtocol,
    lattice: Lattice,
    kind: Kind,
    unit: Option<f32>,
}

#[derive(serde::Deserialize)]
struct OldProtocol {
    version: String,
    source: String,
    rays: u64,
    dropped: u64,
    pixels: Option<Pixels>,
    seed: Option<u64>,
    shard: Option<OldShard>,
    lambda: f64,
    covariance: OldCovariance,
    prior: Prior,
    min_rays: f64,
    criteria: Criteria,
    tolerance: f64,
    march_step: Option<f64>,
    gradient: Option<GradientMethod>,
    difference_step: Option<[f64; 3]>,
    cutoff: Option<f64>,
    background: Option<[f32; 3]>,
    pixel_offset: Option<f64>,
}

#[derive(serde::Deserialize)]
struct OldShard {
    rays: u64,
    index: u64,
    of: u64,
}

impl OldShard {
    fn shard(self) -> Shard {
        let Self { rays, index, of } = self;
        let deal = if of == 1 { Deal::Shifted } else { Deal::Strided };
        Shard { deal, ..Shard::new(rays, index, of) }
    }
}

#[derive(serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum OldCovariance {
    Diagonal,
    Trace,
    Block,
    Normal,
}

/// Information, the mean density gradient that covariance `normal` needed, and the ray count.
type OldSums = [u8; 64];

fn sums(old: &OldSums) -> VertexSums {
    VertexSums::new(Item::take(old), Item::take(&old[60..]))
}

impl OldProtocol {
    fn protocol(self, path: &Path) -> Result<Protocol> {
        let covariance = match self.covariance {
            OldCovariance::Diagonal => Covariance::Diagonal,
            OldCovariance::Trace => Covariance::Trace,
            OldCovariance::Block => Covariance::Block,
            OldCovariance::Normal => {
                let found = "`normal`, which is no longer supported";
                return Err(Error::malformed(path, "header", "covariance `diagonal`, `trace` or `block`", found));
            }
        };
        let old = self;
        Ok(Protocol {
            version: old.version,
            source: old.source,
            origin: Origin::default(),
            rays: old.rays,
            dropped: old.dropped,
            pixels: old.pixels,
            seed: old.seed,
            shard: old.shard.map(OldShard::shard),
            lambda: old.lambda,
            scale: Scale::Paper,
            covariance,
            prior: old.prior,
            min_rays: old.min_rays,
            criteria: old.criteria,
            tolerance: old.tolerance,
            march_step: old.march_step,
            gradient: old.gradient,
            difference_step: old.difference_step,
            cutoff: old.cutoff,
            background: old.background,
            pixel_offset: old.pixel_offset,
        })
    }
}

/// Reads a field of version 1 or 2. Its draws are the one named in its protocol, or unknown.
pub(super) fn read(path: &Path) -> Result<Content> {
    let (old, mut file) = legacy::open::<OldHeader>(path, (FORMAT.0, LAST), &SECTIONS)?;
    let OldHeader { protocol, lattice, kind, unit } = old;
    let protocol = protocol.protocol(path)?;
    let draws = protocol.draw().into_iter().collect();
    let (masks, values) = (file.section("masks")?, file.section("deviations")?);
    let sums: Vec<VertexSums> = file.section::<OldSums>("sums")?.iter().map(sums).collect();
    let surface = file.section("surface")?;
    let logs = file.section::<u16>("logs")?;
    let deviations = match unit {
        None if logs.is_empty() => values,
        // Deviations in two bytes: σ = unit · 10^v.
        Some(unit) if values.is_empty() => {
            logs.iter().map(|&bits| (f64::from(unit) * 10_f64.powf(f16::from_bits(bits).to_f64())) as f32).collect()
        }
        _ => {
            let found = format!("{} and {}", values.len(), logs.len());
            return Err(Error::malformed(path, "sections `deviations` and `logs`", "one of them empty", found));
        }
    };
    let rays: RayCounts = sums.iter().map(|sums| sums.rays).collect();
    let header =
        Header { protocol, lattice, kind, draws, misfit: None, coarser: Vec::new(), conformal: None, tile: None };
    let (limits, errors) = (file.section("limits")?, file.section("errors")?);
    Ok(Content {
        header,
        vertices: Vertices { masks, deviations, sums },
        rays,
        surface,
        visits: Vec::new(),
        has_exact_counts: false,
        limits,
        errors,
        correlations: Vec::new(),
        misfit: (Vec::new(), Vec::new()),
        coarser: Vec::new(),
    })
}
