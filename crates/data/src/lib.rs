//! Files of other programs beside models: cameras and images, masks, depth maps, points, arrays, ray samples.
//!
//! [`Views`] reads the cameras of COLMAP, nerfstudio, Inria's code and `transforms.json` into one frame, and a
//! [`Selection`] says which of them a purpose takes. [`SamplesReader`] reads training rays that another framework
//! differentiated, [`OfficialGrid`] the official code's grid. Every file is untrusted: sizes are compared with the
//! bytes present before anything is allocated, and a key or convention that would change a ray is applied or refused by
//! name.
//!
//! # Example
//! ```
//! use octobayes_data::Views;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("transforms.json");
//! std::fs::write(&path, r#"{
//!     "camera_angle_x": 0.69, "w": 400, "h": 300,
//!     "frames": [{
//!         "file_path": "train/r_0.png",
//!         "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
//!     }]
//! }"#)?;
//! let cameras = Views::read(&path, None)?.cameras();
//! // OpenGL's axes: the camera looks along -z.
//! let ray = cameras[0].ray(200.0, 150.0);
//! assert!((ray.direction + glam::DVec3::Z).length() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod colmap;
mod depth;
mod element;
mod exr;
mod folders;
mod frames;
mod hemisphere;
mod image;
mod inria;
mod intrinsics;
mod jpeg;
mod mask_folders;
mod metashape;
mod nerfstudio;
#[doc(hidden)]
pub mod npy;
#[doc(hidden)]
pub mod npz;
mod official;
mod other_kinds;
mod pictures;
mod points;
mod pose;
mod readings;
mod samples_file;
mod sizes;
mod split;
mod transforms;
mod views;
mod world;

pub use folders::camera_file;
pub use frames::Selection;
pub use official::{OfficialGrid, write_official};
pub use pose::rigid_pose;
pub use samples_file::{SamplesReader, SamplesWriter};
pub use views::{Frame, Purpose, Views};

/// instant-ngp's factor from scene units of NeRF-synthetic data sets to its unit cube.
#[doc(hidden)]
pub const NGP_SCALE: f64 = 0.33;

// What only our own crates name.
#[doc(hidden)]
pub use self::{
    colmap::{ScenePoint, scene_points},
    depth::{DepthEncoding, DepthKind, DepthMap},
    element::{Dtype, Element, Index, Real, Stored},
    exr::write_exr,
    folders::{passed_over, taken_for, test_partner},
    frames::{FrameSplit, Part},
    hemisphere::Hemisphere,
    image::{PosedImage, SampledImage, measure},
    inria::inria_text,
    pictures::{MaskFile, check_masks, each_has_its_own, image_path, memory_of_masks, read_masks, read_object},
    points::PointReader,
    readings::{DepthReadings, LargestDepth, Unmeasured},
    sizes::has_shape,
    transforms::{transforms_text, write_transforms},
    views::ResolutionSource,
    world::{Similarity, frame_beside, frames_of_training},
};
