//! `accumulate`: from ray samples of any origin to a field.

use std::path::PathBuf;
use std::time::Instant;

use super::files::CommandFiles;
use super::options::{DomainOptions, GridOptions, TrainingPixels, count};
use super::progress::Bars;
use super::report::Cost;
use crate::estimate::{FieldBuilder, GridSettings, Provenance};
use crate::geometry::Lattice;
use crate::octree::{MaxLevels, Tile};
use crate::posterior::Census;
use crate::rays::{RunProgress, SamplesReader};
use crate::{Error, Result};

/// Maximal number of vertices in each of the samples by which space is cut into tiles.
const CENSUS: usize = 1 << 16;

/// Sum up ray samples whose Jacobians were computed elsewhere
///
/// SAMPLES.npz holds `positions` (f32, N x 3, scene units); `jacobian` (f32, N x 3 x 3, dC_c/dx_k, rows colour,
/// columns axis); `ray` (u64, N, the index of each sample's ray, never decreasing); and `rays_total`, the
/// number of rays drawn, including those that hit nothing. `weight` (f32, N, the sample's share of the pixel) is
/// optional. Other types of floats and integers are converted. The file may be larger than memory.
#[derive(clap::Args)]
#[command(
    after_help = "Example: octobayes accumulate samples.npz --box=-1.5,-1.5,-1.5,1.5,1.5,1.5 --level 8 -o field.oct"
)]
pub struct Args {
    /// Ray samples
    #[arg(value_name = "SAMPLES.npz")]
    samples: PathBuf,

    #[command(flatten)]
    domain: DomainOptions,

    #[command(flatten)]
    grid: GridOptions,

    /// Number of training pixels, for --scale data
    #[arg(long, value_name = "N", value_parser = count::<u64>(1..))]
    training_pixels: Option<u64>,
}

impl Args {
    /// Refuses samples that all lie outside the box. Warns if half of them do.
    fn check_inside(&self, inside: u64, all: u64) -> Result<()> {
        let found = format!("{inside} of {all} samples");
        if inside == 0 && all > 0 {
            let expected = "samples inside the box (--box); likely causes: units, or axes";
            return Err(Error::malformed(&self.samples, "array `positions`", expected, found));
        }
        if 2 * inside < all {
            announce!("warning: {found} lie in the box; likely causes: --box, units, or axes");
        }
        Ok(())
    }

    /// The tile with its box, which depends on all samples. They are read once more for it.
    fn cut(
        &self,
        settings: &GridSettings,
        reader: &SamplesReader,
        lattice: Lattice,
        bars: &Bars,
    ) -> Result<Option<Tile>> {
        let Some(tile) = settings.tile else { return Ok(None) };
        let mut census = Census::new(lattice, CENSUS, false);
        reader.run(bars, |batches| {
            census.add(batches);
            Ok(())
        })?;
        Ok(Some(census.cut(1.0, &MaxLevels::none(lattice.level()), tile)))
    }

    /// Runs the verb.
    pub fn run(self, bars: &Bars) -> Result<()> {
        CommandFiles::default().input("SAMPLES", &self.samples).output("--output", &self.grid.output).check()?;
        self.grid.check_output()?;
        let reader = SamplesReader::open(&self.samples)?;
        let domain = self.domain.domain(None)?;
        let settings = self.grid.settings(&domain, TrainingPixels { pixels: self.training_pixels, noise: None })?;
        if settings.needs_plan() || settings.criteria.density {
            let expected = "`sensitivity`, and no --memory: the rest needs the model and its rays";
            return Err(Error::setting("--refine", expected, format!("{}", settings.criteria)));
        }
        let settings = settings.tile(self.cut(&settings, &reader, settings.lattice(domain)?, bars)?);
        let mut builder = FieldBuilder::new(settings, domain)?;
        let start = Instant::now();
        let (mut inside, mut all) = (0_u64, 0_u64);
        reader.run(bars, |batches| {
            let positions = || batches.iter().flat_map(|batch| &batch.positions);
            inside += positions().filter(|x| builder.lattice().coordinates(**x).is_some()).count() as u64;
            all += positions().count() as u64;
            builder.add(batches);
            Ok(())
        })?;
        self.check_inside(inside, all)?;
        let sums_bytes = builder.memory();
        let progress = RunProgress { rays: reader.rays_total(), samples: reader.samples(), ..RunProgress::default() };
        let source = format!("samples {}", self.samples.display());
        let field = builder.finish(&Provenance { source, progress, ..Provenance::default() });
        self.grid.write(&field, &Cost { elapsed: start.elapsed(), sums_bytes, step: None })
    }
}
