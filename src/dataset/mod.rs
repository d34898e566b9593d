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

pub use colmap::{ScenePoint, scene_points};
pub use depth::{DepthEncoding, DepthKind, DepthMap};
pub use frames::{Part, Selection, camera_file};
pub use hemisphere::Hemisphere;
pub use image::PosedImage;
pub use pictures::MaskFile;
pub use points::PointReader;
pub use pose::rigid_pose;
pub use readings::{DepthReadings, Unmeasured};
pub use transforms::write_transforms;
pub use views::{Frame, Purpose, ResolutionSource, Views};

// What other features of this crate need. Not `pub(crate)`, because without them it would be unused.
#[doc(hidden)]
pub use frames::{FrameSplit, test_partner};
#[doc(hidden)]
pub use inria::write_inria;
#[doc(hidden)]
pub use pictures::{check_masks, image_path, read_masks};
#[doc(hidden)]
pub use readings::LargestDepth;
