//! Files: NumPy arrays and archives, EXR images, this crate's own container, and writing without half-written
//! results.
//!
//! Readers treat every file as untrusted: they check sizes against the bytes present before they allocate
//! anything.

mod atomic;
mod cell;
pub mod container;
mod element;
#[cfg(feature = "exr")]
mod exr;
pub mod legacy;
pub mod memory;
mod mix;
pub mod npy;
pub mod npz;
pub mod part;
mod place;
mod source;
mod text;

pub use atomic::AtomicFile;
pub use cell::cell;
pub use element::{Element, Index, Real};
#[cfg(feature = "exr")]
pub use exr::{read_exr_depth, write_exr};
pub use mix::mix;
pub use place::{Identity, destination, folder_of};
pub use source::{open, read, refuse_pipe};
pub use text::{read_text, text_of};
