//! Splats as images, and how these change when splats move.
//!
//! The images are those of the original code (Kerbl et al. 2023, `diff-gaussian-rasterization`): EWA splatting with a
//! dilation of 0.3 px², opacities from 1/255 to 0.99, and an end before less than 10⁻⁴ of the light is left. A view of
//! a camera is [prepared](SplatRenderer::prepare) once; any image point of it is composited by itself.
//!
//! Letters, for the splats i that an image point p shows, front to back: `alpha` α = min(0.99, o exp(−q/2)) with
//! q = dᵀ A d and d = m − p; `T` transmittance before it; w = T α; C = Σ w c + T_end · background; `behind`
//! S = Σ_{j>i} w_j c_j + T_end · background.

mod colors;
mod composite;
mod extent;
mod images;
mod jacobian;
mod project;
pub mod reference;
#[cfg(test)]
mod tests;
mod tiles;

pub(super) use colors::color;
pub use composite::{Hit, Hits};
pub use extent::{SeenSpace, seen_domain, share_too_near};
pub use extent::{boxed, middle};
pub use project::Shape;
pub use project::{Footprint, Projector};
pub use tiles::tile_of;
#[doc(hidden)]
pub use {
    composite::{MIN_TRANSMITTANCE, MOST_OPAQUE},
    project::{FAINTEST, FRUSTUM_MARGIN, NEAR},
};

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use self::project::Slope;
use self::tiles::{Tiles, front_to_back};
use super::Splats;
use octobayes::geometry::{Aabb, Camera, Distortion};
use octobayes::render::Outputs;
use octobayes::{Error, Result};

/// Splats in front of a background.
#[derive(Debug, Clone, Copy)]
pub struct SplatRenderer<'a> {
    splats: &'a Splats,
    background: Vec3,
    bounds: Aabb,
}

/// The splats that one camera sees, ready to be composited at any of its image points.
///
/// Takes up to 264 bytes a visible splat, and 28 for each of the 8 px tiles that it covers.
pub struct SplatView<'a> {
    renderer: SplatRenderer<'a>,
    camera: Camera,
    /// Scene to camera: rows right, down, forward.
    rotation: DMat3,
    footprints: Vec<Footprint>,
    /// `[footprints]`, if the view is to be differentiated.
    slopes: Vec<Slope>,
    tiles: Tiles,
}

impl<'a> SplatRenderer<'a> {
    /// Draws `splats` in front of `background` (linear, 0 to 1).
    #[must_use]
    pub fn new(splats: &'a Splats, background: Vec3) -> Self {
        Self { splats, background, bounds: splats.bounds() }
    }

    /// The splats.
    #[must_use]
    pub fn splats(&self) -> &'a Splats {
        self.splats
    }

    /// Colour behind the splats.
    #[must_use]
    pub fn background(&self) -> Vec3 {
        self.background
    }

    /// The box of all centres.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Refuses cameras whose lens distorts: splats are projected as by a pinhole.
    ///
    /// # Errors
    /// If there is one.
    pub fn check_cameras<'c>(cameras: impl IntoIterator<Item = &'c Camera>) -> Result<()> {
        let distorts = |camera: &&Camera| camera.distortion != Distortion::default();
        match cameras.into_iter().find(distorts) {
            None => Ok(()),
            Some(camera) => Err(Error::setting(
                "cameras of splats",
                "no lens distortion, as splats are trained on undistorted images (COLMAP's `image_undistorter`)",
                camera.distortion.to_string(),
            )),
        }
    }

    /// Projects, lists and sorts the splats that a camera without distortion sees.
    #[must_use]
    #[doc(hidden)]
    pub fn prepare(&self, camera: &Camera, to: Outputs) -> SplatView<'a> {
        let projector = Projector::new(camera);
        let footprints: Vec<Footprint> = (0..self.splats.len())
            .into_par_iter()
            .with_min_len(1024)
            .filter_map(|i| projector.footprint(self.splats, i))
            .collect();
        // In the order in which they are listed and composited: memory is then read from beginning to end.
        let order = front_to_back(&footprints);
        let footprints: Vec<Footprint> = order.par_iter().map(|&i| footprints[i as usize]).collect();
        let slopes: Vec<Slope> = match to {
            Outputs::Colors => Vec::new(),
            Outputs::Derivatives => footprints
                .par_iter()
                .with_min_len(1024)
                .map(|footprint| projector.slope(self.splats, footprint))
                .collect(),
        };
        let tiles = Tiles::new(&footprints, camera.resolution);
        SplatView { renderer: *self, camera: *camera, rotation: projector.rotation, footprints, slopes, tiles }
    }
}

impl SplatView<'_> {
    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Index of the splat of a hit.
    #[must_use]
    pub fn splat(&self, hit: &Hit) -> usize {
        self.footprints[hit.footprint as usize].splat as usize
    }

    /// The splats that this view may show, and their colours in it, 0 or more.
    pub fn colors(&self) -> impl Iterator<Item = (usize, DVec3)> {
        self.footprints.iter().map(|footprint| (footprint.splat as usize, footprint.color))
    }

    /// Direction of the view axis.
    fn forward(&self) -> DVec3 {
        self.rotation.row(2)
    }
}
