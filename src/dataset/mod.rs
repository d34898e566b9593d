//! Posed images and their split, depth maps, and lists of points.

mod colmap;
mod depth;
mod frames;
mod hemisphere;
mod image;
mod points;
mod readings;
mod transforms;

pub use depth::{DepthEncoding, DepthKind, DepthMap};
pub use frames::{FrameSplit, Part, Selection, camera_file, test_partner};
pub use hemisphere::Hemisphere;
pub use image::PosedImage;
pub use points::PointReader;
pub use readings::{DepthReadings, Unmeasured};
pub use transforms::{Frame, ResolutionSource, Views, image_path, rigid_pose, write_transforms};
