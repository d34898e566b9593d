//! From a field and its training cameras to its uncertainty.
//!
//! An [`Estimation`] holds everything that a run depends on, and runs it: as a whole or one shard, in groups with
//! error bars, or until a mean error is reached. It can be resumed from a [`Checkpoint`]. [`RaySettings`] say
//! which rays are drawn and how they are differentiated, [`GridSettings`] on which grid their information is
//! summed. [`FieldBuilder`] is the second half alone, for samples from elsewhere.

mod audit;
mod builder;
mod checkpoint;
mod coarser;
mod draw;
mod error_budget;
mod estimation;
mod facts;
mod field_builder;
mod forecast;
mod framing;
mod grid;
mod growth;
mod mean_error;
mod model;
mod plan;
mod positions;
mod rays;
mod run;
mod sight;
mod step;

pub use audit::{Audit, MarchShift};
pub use builder::{FieldSource, SURFACE_POINTS};
pub use checkpoint::Checkpoint;
pub use error_budget::{ErrorBudget, RayError};
pub use estimation::{Estimation, Goal};
pub use facts::facts;
pub use field_builder::FieldBuilder;
pub use framing::Framing;
pub use grid::{GridKind, GridSettings};
pub use mean_error::SamplingError;
pub use model::{Feature, Model, known_cameras, lacks_of_no_field, require};
pub use plan::Plan;
pub use positions::PositionCheck;
pub use rays::RaySettings;
pub use run::{Outcome, Run};
pub use sight::CoverageCheck;
pub use step::StepCheck;

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use checkpoint::RunKey;

#[cfg(test)]
mod tests;
