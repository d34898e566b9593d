//! Files: NumPy arrays and archives, EXR images, this crate's own container, and writing without half-written
//! results.
//!
//! Readers treat every file as untrusted: they check sizes against the bytes present before they allocate
//! anything.

mod atomic;
mod cell;
pub mod container;
#[cfg(feature = "files")]
mod element;
#[cfg(feature = "exr")]
mod exr;
pub mod memory;
mod mix;
#[cfg(feature = "files")]
pub mod npy;
#[cfg(feature = "files")]
pub mod npz;
pub mod place;
pub mod sorted;
mod source;
#[cfg(feature = "files")]
mod whole;

pub use atomic::beside;
pub use atomic::{AtomicFile, remove_leftovers};
pub use cell::cell;
#[cfg(feature = "files")]
pub use element::{Dtype, Element, Index, Real, Stored};
#[cfg(feature = "exr")]
pub use exr::read_exr_depth;
#[cfg(feature = "exr")]
pub use exr::write_exr;
pub use mix::{evenly, mix};
pub use source::open;
#[cfg(feature = "files")]
pub use source::refuse_pipe;
#[cfg(feature = "files")]
pub use whole::{read, read_text, text_of};
