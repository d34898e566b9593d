//! Posed images and their split, depth maps, and lists of points.

mod colmap;
mod depth;
mod frames;
mod hemisphere;
mod image;
mod inria;
mod intrinsics;
mod other_kinds;
mod pictures;
mod points;
mod pose;
mod readings;
mod split;
mod transforms;
mod views;

pub use depth::{DepthEncoding, DepthKind, DepthMap};
pub use frames::{FrameSplit, Part, Selection, camera_file, test_partner};
pub use hemisphere::Hemisphere;
pub use image::PosedImage;
pub use inria::write_inria;
pub use pictures::{MaskFile, check_masks, image_path, read_masks};
pub use points::PointReader;
pub use pose::rigid_pose;
pub use readings::{DepthReadings, LargestDepth, Unmeasured};
pub use transforms::write_transforms;
pub use views::{Frame, Purpose, ResolutionSource, Views};
