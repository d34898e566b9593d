//! Posed images and their split, depth maps, and lists of points.

mod colmap;
mod depth;
mod frames;
mod hemisphere;
mod image;
mod inria;
mod intrinsics;
mod jpeg;
mod mask_folders;
mod other_kinds;
mod pictures;
mod points;
mod pose;
mod readings;
mod split;
mod transforms;
mod views;

pub use frames::{Selection, camera_file};
pub use pose::rigid_pose;
pub use views::{Frame, Purpose, Views};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{
    colmap::{ScenePoint, scene_points},
    depth::{DepthEncoding, DepthKind, DepthMap},
    frames::{FrameSplit, Part, test_partner},
    hemisphere::Hemisphere,
    image::{PosedImage, SampledImage, measure},
    inria::write_inria,
    pictures::{MaskFile, check_masks, image_path, memory_of_masks, read_masks},
    points::PointReader,
    readings::{DepthReadings, LargestDepth, Unmeasured},
    transforms::write_transforms,
    views::ResolutionSource,
};
