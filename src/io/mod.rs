//! Files of general formats: NumPy arrays and archives, CSV points, and writing without half-written results.
//!
//! Readers treat every file as untrusted: sizes are checked against the bytes that are there before anything is allocated.

mod atomic;
pub mod npy;
pub mod npz;

pub use atomic::AtomicFile;
