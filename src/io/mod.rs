//! Files: NumPy arrays and archives, this crate's own container, and writing without half-written results.
//!
//! Readers treat every file as untrusted: sizes are checked against the bytes that are there before anything is allocated.

mod atomic;
pub mod container;
#[cfg(feature = "synth")]
mod exr;
pub mod legacy;
pub mod memory;
pub mod npy;
pub mod npz;
mod place;

pub use atomic::AtomicFile;
#[cfg(feature = "synth")]
pub use exr::write_exr;
pub use place::{Identity, destination, folder_of};
