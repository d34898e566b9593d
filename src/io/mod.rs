//! Files: NumPy arrays and archives, this crate's own container, and writing without half-written results.
//!
//! Readers treat every file as untrusted: sizes are checked against the bytes that are there before anything is allocated.

mod atomic;
pub mod container;
pub mod legacy;
pub mod npy;
pub mod npz;
mod place;

pub use atomic::AtomicFile;
pub use place::{Identity, destination, folder_of};
