//! Training rays before anything is summed: which pixels are drawn, in which order, and the samples of each ray.
//!
//! A run of `R` rays is split into batches of 512, and any batch can be drawn by itself. [`PixelSequence`]
//! chooses the pixel of each ray. [`RayStream`] traces and differentiates it. [`Shard`] is the part of a run that
//! one process draws, and [`RunProgress`] records how far it has come. Samples with Jacobians that were computed
//! elsewhere are [gathered](Gathered) instead.

mod by_camera;
mod gathered;
mod missing;
mod pixels;
mod portions;
mod seeds;
mod shard;
mod stream;

// What only files and Python name.
#[doc(hidden)]
pub use gathered::Gathered;
pub use gathered::MOST_SAMPLES;
pub use missing::MissingShards;
pub use pixels::Pixels;
pub(crate) use seeds::Purpose;
pub(crate) use shard::MAX_RAYS;
pub use shard::{RaySet, RunProgress, Shard};
pub use stream::{MAX_DROPPED_SHARE, RayStream, SURFACE_WEIGHT};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::pixels::{PixelSample, PixelSequence};
pub(crate) use self::stream::End;
