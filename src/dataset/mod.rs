//! Posed images, depth maps, and lists of points.

mod depth;
mod image;
pub mod points;
mod transforms;

pub use depth::{DepthEncoding, DepthKind, DepthMap};
pub use image::PosedImage;
pub use transforms::{Frame, ResolutionSource, Views, write_transforms};
