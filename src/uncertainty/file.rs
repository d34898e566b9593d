//! The field file, `.oct`.
//!
//! It is a [container] whose header holds protocol, lattice, draws and a calibrated interval of depth, and whose
//! sections are
//!
//! ```text
//! masks        u8         child masks of the octree, breadth first (empty for a dense grid)
//! deviations   f32        σ_v, by vertex (octree: finest first, in Morton order; dense: x slowest)
//! rays         u8         codes of ray counts, by vertex; or empty if unknown
//! factors      28 bytes   Cholesky factors of the sums, by vertex: f32 × 6, u32 rays; or empty
//! exact        52 bytes   instead of `factors`, the sums themselves: f64 × 6 information, u32 rays; or empty
//! surface      f32 × 3    points on visible surfaces
//! visits       u8         codes of ray counts by cell of the coarse grid, x slowest; or empty if unknown
//! counted      u32        instead of `visits`: the counts themselves
//! limits       u64        the regions' level, then region · 256 + limit; empty if nothing is limited
//! errors       u16        number of groups, then bits of f16: errors of log10 σ_v, NaN where not known; or empty
//! correlations f32        by vertex, x, y and z: displacements in each draw of all of them together; or empty
//! misfit vertices u64     Morton codes of points of the misfit's lattice, ascending; or empty
//! misfit       f32        mean square residual of training images around each of them
//! masks 1, deviations 1, factors 1    the same as without the number, on the next coarser level; then 2, 3, …
//! ```
//!
//! A shard keeps exact sums and counts, so that shards merge to the sums of one run. A whole run that keeps its sums
//! keeps the factors, which answer for every covariance to within 1e-6 decades.
//!
//! The octree is rebuilt from its masks, so a file cannot hold an inconsistent one. Versions 1 and 2 can be
//! [read](legacy) too.

mod legacy;
mod vertices;

use std::path::Path;

use self::vertices::{Coarser, Factors, Vertices, Written};
use super::merge::Head;
use super::misfit;
use super::{Conformal, Correlations, ErrorBars, Misfit, Protocol, RayCounts, Support, UncertaintyField, vertex_count};
use crate::geometry::Lattice;
use crate::io::container::{self, Format, Reader, Section};
use crate::octree::{MaxLevels, Tile};
use crate::posterior::{Scale, Visits};
use crate::rays::Draw;
use crate::{Error, Result};

/// The newest version that this crate reads, and the one that it writes.
pub const FORMAT_VERSION: u32 = 3;
const FORMAT: Format = (b"OCTOBAY\n", FORMAT_VERSION);

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    protocol: Protocol,
    lattice: Lattice,
    kind: Kind,
    /// The rays that were summed, by sequence of pixels; empty if unknown.
    draws: Vec<Draw>,
    /// What training left unexplained, if that is known: its sections may be empty.
    #[serde(default)]
    misfit: Option<misfit::Head>,
    /// Coarser levels of the same rays, finest first; usually none.
    #[serde(default)]
    coarser: Vec<Coarser>,
    /// The calibrated interval of depth, if there is one.
    #[serde(default)]
    conformal: Option<Conformal>,
    /// The part of space that the sums are of, if not all.
    #[serde(default)]
    tile: Option<Tile>,
}

impl Header {
    /// Checks what constructors would: deserialisation bypasses them. Returns the lattice.
    fn check(&self, path: &Path) -> Result<Lattice> {
        let Self { protocol, draws, coarser, conformal, tile, .. } = self;
        let lattice = self.lattice.domain().checked();
        let lattice = lattice
            .and_then(|domain| Lattice::from_domain(domain, self.lattice.level()))
            .map_err(|e| Error::malformed(path, "header", "a valid domain and level", e.to_string()))?;
        if !protocol.is_possible() {
            let expected = "a protocol that a run can have";
            return Err(Error::malformed(path, "header", expected, format!("{protocol:?}")));
        }
        let is_dense = matches!(self.kind, Kind::Dense);
        if tile.is_some_and(|tile| is_dense || !tile.fits(lattice.level())) {
            return Err(Error::malformed(path, "header, tile", "a part of an octree's box", format!("{tile:?}")));
        }
        if !draws.iter().all(|draw| draw.shard.is_valid()) || !Draw::are_disjoint(draws.iter().copied()) {
            let found = "an empty part, or two that may have rays in common";
            return Err(Error::malformed(path, "header, draws", "parts of runs, each ray in one of them", found));
        }
        let is_possible = |lambda| Protocol { lambda, ..protocol.clone() }.is_possible();
        let most = UncertaintyField::most_coarser(lattice.level());
        if coarser.len() > usize::from(most) {
            let (expected, found) = (format!("at most {most}"), coarser.len().to_string());
            return Err(Error::malformed(path, "header, coarser levels", expected, found));
        }
        if let Some(coarser) = coarser.iter().find(|coarser| !is_possible(coarser.lambda)) {
            let expected = "priors that a run can have";
            return Err(Error::malformed(path, "header, coarser levels", expected, coarser.lambda.to_string()));
        }
        if let Some(conformal) = conformal.filter(|conformal| !conformal.is_possible()) {
            let expected = "an interval that a calibration can give";
            return Err(Error::malformed(path, "header, conformal", expected, format!("{conformal:?}")));
        }
        Ok(lattice)
    }
}

#[derive(serde::Serialize, serde::Deserialize)]
enum Kind {
    Dense,
    Octree { root_split: bool },
}

impl Kind {
    /// What the header says of the vertices, and the masks of their cells.
    fn and_masks(support: &Support) -> (Self, Vec<u8>) {
        match support {
            Support::Dense => (Self::Dense, Vec::new()),
            Support::Octree(octree) => {
                let (root_split, masks) = octree.cells().raw();
                (Self::Octree { root_split }, masks)
            }
        }
    }
}

/// What a file holds, before it is checked.
struct Content {
    header: Header,
    vertices: Vertices,
    rays: RayCounts,
    surface: Vec<[f32; 3]>,
    /// Ray counts by cell of the coarse grid; empty if unknown.
    visits: Vec<u32>,
    /// Whether these are the counts themselves, as only parts of runs keep them.
    has_exact_counts: bool,
    limits: Vec<u64>,
    errors: Vec<u16>,
    correlations: Vec<f32>,
    /// Vertices of the misfit, and their residuals.
    misfit: (Vec<u64>, Vec<f32>),
    /// Of coarser levels, finest first.
    coarser: Vec<Vertices>,
}

impl Content {
    fn read(path: &Path) -> Result<Self> {
        let (header, mut file) = Reader::open::<Header>(path, FORMAT)?;
        let masks = file.section("masks")?;
        let deviations = file.section("deviations")?;
        let rays = RayCounts(file.optional("rays")?);
        let factors = vertices::read_factors(path, &mut file, "factors")?;
        let exact = file.optional("exact")?;
        let sums = if exact.is_empty() { factors } else { exact };
        let vertices = Vertices { masks, deviations, sums };
        let surface = file.optional("surface")?;
        let visits = RayCounts(file.optional("visits")?);
        let counted = file.optional("counted")?;
        let has_exact_counts = !counted.is_empty();
        let visits =
            if has_exact_counts { counted } else { visits.iter().map(|n| n.min(u32::MAX.into()) as u32).collect() };
        let (limits, errors, correlations) =
            (file.optional("limits")?, file.optional("errors")?, file.optional("correlations")?);
        let misfit = (file.optional("misfit vertices")?, file.optional("misfit")?);
        let coarser = (1..=header.coarser.len()).map(|below| Vertices::of_coarser(path, &mut file, below));
        let coarser = coarser.collect::<Result<_>>()?;
        Ok(Self {
            header,
            vertices,
            rays,
            surface,
            visits,
            has_exact_counts,
            limits,
            errors,
            correlations,
            misfit,
            coarser,
        })
    }
}

impl UncertaintyField {
    /// Writes the field. The file appears either complete or not at all.
    ///
    /// # Errors
    /// If the folder is not writable or the disk is full.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (kind, masks) = Kind::and_masks(&self.support);
        let (protocol, draws) = (self.protocol.clone(), self.draws.clone());
        let (lattice, conformal, tile) = (self.lattice, self.conformal, self.tile);
        let misfit = self.misfit.as_ref().map(Misfit::head);
        let (coarser, levels): (_, Vec<Written>) = self.coarser.iter().map(Written::new).unzip();
        let header = Header { protocol, lattice, kind, draws, misfit, coarser, conformal, tile };
        let (misfit_vertices, misfit) = self.misfit.as_ref().map_or_else(Default::default, Misfit::vertices);
        let sums = self.sums.as_deref().unwrap_or_default();
        let is_exact = self.is_to_be_merged();
        let exact = if is_exact { sums } else { &[] };
        let factors = Factors(if is_exact { &[] } else { sums });
        let limits = self.limits.packed().unwrap_or_default();
        let errors = self.error_bars.as_ref().map(ErrorBars::words).unwrap_or_default();
        let correlations = self.correlations.as_ref().map_or(&[][..], Correlations::displacements);
        let counts = self.visits.as_ref().map_or(&[][..], Visits::counts);
        let counted = if is_exact { counts } else { &[] };
        let visits = if is_exact { RayCounts::default() } else { counts.iter().copied().collect() };
        let names: Vec<[String; 3]> = (1..=levels.len()).map(vertices::names).collect();
        let mut sections: Vec<(&str, &dyn Section)> = vec![
            ("masks", &masks),
            ("deviations", &self.deviations.0),
            ("rays", &self.rays.0),
            ("factors", &factors),
            ("exact", &exact),
            ("surface", &self.surface),
            ("visits", &visits.0),
            ("counted", &counted),
            ("limits", &limits),
            ("errors", &errors),
            ("correlations", &correlations),
            ("misfit vertices", &misfit_vertices),
            ("misfit", &misfit),
        ];
        sections.extend(levels.iter().zip(&names).flat_map(|(level, names)| level.sections(names)));
        container::write(path, FORMAT, &header, &sections)
    }

    /// Reads and checks what the header of a file says. What follows is read by [`UncertaintyField::read`] only.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not a field of a known version.
    pub(super) fn read_head(path: &Path) -> Result<Head> {
        let name = path.display().to_string();
        if container::version(path, FORMAT)? < FORMAT_VERSION {
            return Self::read(path).map(|field| Head::of(name, &field));
        }
        let (header, file) = Reader::open::<Header>(path, FORMAT)?;
        let lattice = header.check(path)?;
        let Header { protocol, kind, draws, tile, .. } = header;
        let has_sums = ["exact", "factors"].into_iter().any(|name| file.has(name));
        let (is_dense, has_error_bars) = (matches!(kind, Kind::Dense), file.has("errors"));
        Ok(Head { name, protocol, lattice, draws, tile, is_dense, has_sums, has_error_bars })
    }

    /// Whether a file holds error bars, by its header.
    ///
    /// # Errors
    /// If the file is missing, or is not complete, or not a field of a known version.
    pub fn has_error_bars(path: &Path) -> Result<bool> {
        Self::read_head(path).map(|head| head.has_error_bars)
    }

    /// Reads a field.
    ///
    /// # Errors
    /// If the file is missing, or is not a complete, unaltered field of a known version.
    pub fn read(path: &Path) -> Result<Self> {
        let is_old = container::version(path, FORMAT)? < FORMAT_VERSION;
        let content = if is_old { legacy::read(path)? } else { Content::read(path)? };
        let Content {
            header,
            vertices,
            rays,
            surface,
            visits,
            has_exact_counts,
            limits,
            errors,
            correlations,
            misfit,
            coarser,
        } = content;
        let lattice = header.check(path)?;
        let protocol = header.protocol;
        let tile = header.tile;
        let is_part = tile.is_some() || protocol.is_part() || header.draws.iter().any(Draw::is_part);
        if !header.coarser.is_empty() && (is_part || !limits.is_empty()) {
            let expected = "none in a part of a run, or with limited leaves";
            return Err(Error::malformed(path, "header, coarser levels", expected, "some"));
        }
        if has_exact_counts && !is_part {
            return Err(Error::malformed(path, "section `counted`", "counts of a part of a run", "a whole run's"));
        }
        if let Some(i) = surface.iter().position(|x| !x.iter().all(|v| v.is_finite())) {
            let found = format!("{:?}", surface[i]);
            return Err(Error::malformed(path, format!("section `surface`, point {i}"), "finite coordinates", found));
        }
        let limits = match limits.as_slice() {
            [] => MaxLevels::none(lattice.level()),
            packed => MaxLevels::from_packed(lattice.level(), packed)
                .ok_or_else(|| Error::malformed(path, "section `limits`", "balanced limits to refinement", "others"))?,
        };

        let visits = match visits {
            counts if counts.is_empty() => None,
            counts => Some(Visits::from_counts(&lattice, counts).ok_or_else(|| {
                Error::malformed(
                    path,
                    "section `visits`",
                    "a count for every cell of the coarse grid",
                    "another number",
                )
            })?),
        };
        let (support, deviations, sums) = vertices.check(path, &lattice, &header.kind, "")?;
        let vertices = vertex_count(&lattice, &support);
        if !rays.is_empty() && rays.len() as u64 != vertices {
            let expected = format!("{vertices} entries, one per vertex");
            return Err(Error::malformed(path, "section `rays`", expected, rays.len().to_string()));
        }
        let error_bars = (!errors.is_empty()).then(|| ErrorBars::from_words(&errors, vertices)).transpose();
        let error_bars =
            error_bars.map_err(|(expected, found)| Error::malformed(path, "section `errors`", expected, found))?;
        let correlations =
            (!correlations.is_empty()).then(|| Correlations::from_file(correlations, vertices)).transpose();
        let correlations = correlations
            .map_err(|(expected, found)| Error::malformed(path, "section `correlations`", expected, found))?;
        if correlations.is_some() && (is_part || !limits.is_unlimited()) {
            let expected = "none in a part of a run, or with limited leaves";
            return Err(Error::malformed(path, "section `correlations`", expected, "some"));
        }
        let misfit = match header.misfit {
            None if misfit.0.is_empty() && misfit.1.is_empty() => None,
            None => {
                return Err(Error::malformed(path, "section `misfit`", "none, as the header has no misfit", "some"));
            }
            Some(_) if tile.is_some() || protocol.scale == Scale::Paper => {
                let expected = "none in a tile, or where depths have no deviations";
                return Err(Error::malformed(path, "header, misfit", expected, "one"));
            }
            Some(head) => Some(
                Misfit::from_file(&lattice, head, misfit)
                    .map_err(|(expected, found)| Error::malformed(path, "section `misfit`", expected, found))?,
            ),
        };
        let (draws, conformal) = (header.draws, header.conformal);
        let field = Self {
            protocol,
            lattice,
            support,
            limits,
            deviations,
            rays,
            sums,
            error_bars,
            surface,
            visits,
            draws,
            correlations,
            misfit,
            coarser: Vec::new(),
            conformal,
            tile,
        };
        let coarser = (1..).zip(coarser).zip(header.coarser);
        let coarser = coarser.map(|((below, vertices), head)| vertices.into_coarser(path, &field, below, head));
        let coarser = coarser.collect::<Result<_>>()?;
        Ok(Self { coarser, ..field })
    }
}
