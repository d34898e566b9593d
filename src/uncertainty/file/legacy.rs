//! Fields of versions 1 and 2, whose headers are positional. Their content is frozen here.

use std::path::Path;

use super::{FORMAT, Header, Kind};
use crate::Result;
use crate::geometry::Lattice;
use crate::io::container::Reader;
use crate::io::legacy;
use crate::posterior::{Covariance, Criteria, Prior};
use crate::rays::{Pixels, Shard};
use crate::render::GradientMethod;
use crate::uncertainty::{Origin, Protocol};

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
    shard: Option<Shard>,
    lambda: f64,
    covariance: Covariance,
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

impl From<OldProtocol> for Protocol {
    fn from(old: OldProtocol) -> Self {
        Self {
            version: old.version,
            source: old.source,
            origin: Origin::default(),
            rays: old.rays,
            dropped: old.dropped,
            pixels: old.pixels,
            seed: old.seed,
            shard: old.shard,
            lambda: old.lambda,
            covariance: old.covariance,
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
        }
    }
}

/// Opens a field of version 1 or 2. Its draws are the one named in its protocol, or unknown.
pub(super) fn open(path: &Path) -> Result<(Header, Reader)> {
    let (old, file) = legacy::open::<OldHeader>(path, (FORMAT.0, LAST), &SECTIONS)?;
    let OldHeader { protocol, lattice, kind, unit } = old;
    let protocol = Protocol::from(protocol);
    let draws = protocol.draw().into_iter().collect();
    Ok((Header { protocol, lattice, kind, unit, draws }, file))
}
