//! From ray samples of any origin to a field.

use std::path::Path;
use std::time::Instant;

use super::{Finished, checks};
use octobayes::estimate::{ErrorBudget, FieldBuilder, FieldSource, GridSettings};
use octobayes::geometry::Domain;
use octobayes::monitor::Message;
use octobayes::monitor::Monitor;
use octobayes::posterior::Pooling;
use octobayes::rays::RunProgress;
use octobayes::render::RaySamples;
use octobayes::{Error, Result};
use octobayes_data::SamplesReader;

/// Sums of samples whose Jacobians were computed elsewhere.
pub struct Accumulation {
    builder: FieldBuilder,
    pooling: Pooling,
    /// Samples inside the box, and all.
    inside: u64,
    all: u64,
    start: Instant,
}

impl Accumulation {
    /// Creates sums without samples.
    ///
    /// # Errors
    /// If the settings need the model and its rays, or as [`FieldBuilder::new`].
    pub fn new(settings: GridSettings, domain: Domain) -> Result<Self> {
        if settings.is_limited() || settings.criteria.density {
            let expected = "`sensitivity`: the rest needs the model and its rays";
            return Err(Error::setting("--refine", expected, settings.criteria.to_string()));
        }
        let (builder, pooling) = (FieldBuilder::new(settings, domain)?, settings.pooling);
        Ok(Self { builder, pooling, inside: 0, all: 0, start: Instant::now() })
    }

    /// Adds samples, in ray order.
    pub fn add(&mut self, batches: &[RaySamples]) {
        let positions = || batches.iter().flat_map(|batch| &batch.positions);
        self.inside += positions().filter(|x| self.builder.lattice().coordinates(**x).is_some()).count() as u64;
        self.all += positions().count() as u64;
        self.builder.add(batches);
    }

    /// Adds the samples of a file, and computes the field.
    ///
    /// # Errors
    /// If the file cannot be read, as [`Accumulation::finish`], or if the work was interrupted.
    pub fn read(
        mut self,
        reader: &SamplesReader,
        monitor: &dyn Monitor,
        tell: &mut dyn FnMut(Message),
    ) -> Result<Finished> {
        self.start = Instant::now();
        reader.run(monitor, |batches| {
            self.add(batches);
            Ok(())
        })?;
        let path = reader.path();
        self.finish(path, &format!("samples {}", path.display()), reader.rays_total(), tell)
    }

    /// Computes the field of the samples so far, which belong to `rays` rays. `place` names them in errors, `source` in
    /// the field.
    ///
    /// # Errors
    /// If all samples lie outside the box.
    pub fn finish(self, place: &Path, source: &str, rays: u64, tell: &mut dyn FnMut(Message)) -> Result<Finished> {
        let Self { builder, pooling, inside, all, start } = self;
        let found = format!("{inside} of {all} samples");
        if inside == 0 && all > 0 {
            let expected = "samples inside the box (--box); likely causes: units, or axes";
            return Err(Error::malformed(place, "array `positions`", expected, found));
        }
        if 2 * inside < all {
            tell(Message::Warning(format!("{found} lie in the box; likely causes: --box, units, or axes")));
        }
        let sums_bytes = builder.memory();
        let progress = RunProgress { rays, samples: all, ..RunProgress::default() };
        let field = builder.finish(&FieldSource { source: source.into(), progress, ..FieldSource::default() })?;
        checks::field(&field, pooling, true, tell);
        let errors = ErrorBudget::of_field(&field);
        Ok(Finished {
            field,
            errors,
            elapsed: start.elapsed(),
            sums_bytes,
            images: None,
            disk_bytes: 0,
            checkpoint: None,
        })
    }
}
