//! `--correlations`: displacements of all vertices drawn together, from every row of a run's Jacobian.

use super::{Args, Rays};
use crate::cli::progress::Bars;
use crate::cli::report;
use crate::estimate::GridSettings;
use crate::geometry::Domain;
use crate::io::memory::available;
use crate::posterior::{DataScale, Draws, FullPosterior, Posterior, Scale};
use crate::render::RaySamples;
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Where conjugate gradients end: far below the draws' own error, √(2/n).
const RESIDUAL: f64 = 1e-2;
/// Most iterations; level 6 takes some 170.
const ITERATIONS: usize = 2000;
/// What solving takes in multiples of the rows: these, sorted by vertex, and vectors over rays and vertices.
const BESIDE_ROWS: f64 = 2.0;

/// The rows of J while a run draws its rays.
pub struct Together {
    full: FullPosterior,
    scale: DataScale,
    draws: Draws,
}

impl Together {
    /// Nothing yet; `None` if it is not asked for.
    ///
    /// # Errors
    /// If the run is one that draws cannot be made of.
    pub fn new(args: &Args, grid: &GridSettings, domain: Domain) -> Result<Option<Self>> {
        let Some(number) = args.correlations else { return Ok(None) };
        let wrong = |expected: &str, found: &str| Err(Error::setting("--correlations", expected, found));
        let Scale::Data(scale) = grid.scale else {
            return wrong("--scale data, in which displacements are lengths", "the paper's");
        };
        if args.rays == Rays::Auto {
            return wrong("a number of rays, every row of which is kept", "--rays auto");
        }
        if grid.rays_per_vertex() > 0.0 {
            return wrong("leaves as fine as the level", "--refine ray-count");
        }
        // Where there is no density, vertices that rays moved would be missing, and their draws with them.
        if !grid.criteria.sensitivity && !grid.criteria.uniform {
            return wrong("leaves as fine as the level wherever rays moved a vertex", "--refine density alone");
        }
        let draws = Draws { number: number.into(), seed: args.seed, residual: RESIDUAL, iterations: ITERATIONS };
        Ok(Some(Self { full: FullPosterior::new(grid.lattice(domain)?), scale, draws }))
    }

    /// Keeps the rows of some rays.
    ///
    /// # Errors
    /// If they take more memory than there is.
    pub fn add(&mut self, batches: &[RaySamples]) -> Result<()> {
        self.full.add(batches);
        let needed = BESIDE_ROWS * self.full.memory() as f64;
        check(needed as u64, available())
    }

    /// The field with draws from the posterior of `rays` rays.
    ///
    /// # Errors
    /// If the draws are not found, or the work was interrupted.
    pub fn join(self, field: UncertaintyField, rays: u64, bars: &Bars) -> Result<UncertaintyField> {
        field.with_correlations(&self.full.draw(rays, self.scale, self.draws, bars)?)
    }
}

/// Whether what solving needs so far is free, bytes; what is free may be unknown.
fn check(needed: u64, left: Option<u64>) -> Result<()> {
    let Some(left) = left.filter(|left| needed > *left) else { return Ok(()) };
    let [needed, left] = [needed, left].map(|bytes| report::bytes(bytes as usize));
    let expected = format!("{needed} for rows so far; fewer --rays or a lower --level");
    Err(Error::setting("--correlations", expected, format!("{left} free")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_memory_than_there_is_is_said() {
        let error = check(3_000_000_001, Some(3_000_000_000)).unwrap_err().to_string();
        assert!(error.contains("--correlations") && error.contains("fewer --rays"), "{error}");
        assert!(error.contains("3.00 GB for rows") && error.contains("3.00 GB free"), "{error}");
        assert!(check(3_000_000_000, Some(3_000_000_000)).is_ok() && check(u64::MAX, None).is_ok());
    }
}
