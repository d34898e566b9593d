//! Training rays, up to the moment before anything is summed: which pixels are drawn, in which order, and what a ray says.
//!
//! A run of `R` rays is cut into batches of 512, and any batch can be drawn alone. [`PixelSequence`] says through which pixel each ray goes,
//! [`RayStream`] traces and differentiates it, [`Shard`] is the part of a run that one process draws, and [`RunProgress`] how far it has come. Samples
//! with Jacobians that were computed elsewhere come from a [file](SamplesReader) instead.

mod pixels;
mod progress;
mod samples_file;
mod seeds;
mod shard;
mod stream;

pub use pixels::{Pick, PixelSequence, Pixels};
pub use progress::RunProgress;
pub use samples_file::{SamplesReader, SamplesWriter};
pub use seeds::Purpose;
pub use shard::{Draw, Shard};
pub use stream::{MAX_DROPPED_SHARE, RayStream, SURFACE_WEIGHT};
