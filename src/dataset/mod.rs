//! Posed images and their split, depth maps, and lists of points.

mod colmap;
mod depth;
mod folders;
mod frames;
mod hemisphere;
mod image;
mod inria;
mod intrinsics;
mod jpeg;
mod mask_folders;
mod nerfstudio;
mod other_kinds;
mod pictures;
mod points;
mod pose;
mod readings;
mod sizes;
mod split;
mod transforms;
mod views;
mod world;

pub use folders::camera_file;
pub use frames::Selection;
pub use pose::rigid_pose;
pub use views::{Frame, Purpose, Views};

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{
    colmap::{ScenePoint, scene_points},
    depth::{DepthEncoding, DepthKind, DepthMap},
    folders::{passed_over, taken_for, test_partner},
    frames::{FrameSplit, Part},
    hemisphere::Hemisphere,
    image::{PosedImage, SampledImage, measure},
    inria::inria_text,
    pictures::{MaskFile, check_masks, image_path, memory_of_masks, read_masks},
    points::PointReader,
    readings::{DepthReadings, LargestDepth, Unmeasured},
    sizes::has_shape,
    transforms::{transforms_text, write_transforms},
    views::ResolutionSource,
    world::{Similarity, frame_beside, frames_of_training},
};
