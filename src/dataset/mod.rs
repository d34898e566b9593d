//! Posed images and depth maps.

mod depth;
mod image;
mod transforms;

pub use depth::{DepthEncoding, DepthKind, DepthMap};
pub use image::PosedImage;
pub use transforms::{Frame, ResolutionSource, Views, write_transforms};
