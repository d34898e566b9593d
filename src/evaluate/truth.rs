//! What a held-out camera should see.

use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::Result;
use crate::dataset::{DepthEncoding, DepthKind, DepthMap, Frame, PosedImage};
use crate::geometry::Camera;

/// Location of true depth maps.
#[derive(Debug, Clone)]
pub struct DepthFiles {
    /// Folder of the maps.
    pub folder: PathBuf,
    /// File name; `{}` is the frame's file name without extension.
    pub pattern: String,
    /// Meaning of their values.
    pub encoding: DepthEncoding,
}

impl DepthFiles {
    /// Path of the depth map of a frame with this `file_path`.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        let stem = Path::new(name).file_name().unwrap_or_default().to_string_lossy();
        let stem = [".png", ".jpg", ".jpeg"].iter().fold(&*stem, |s, e| s.trim_end_matches(e));
        self.folder.join(self.pattern.replace("{}", stem))
    }
}

/// What a held-out camera should see, for some of its pixels.
#[derive(Debug, Clone)]
pub struct TrueView {
    /// The frame's `file_path`.
    pub name: String,
    /// A camera with exactly these pixels.
    pub camera: Camera,
    /// Position in a pixel that its ray passes through, 0 to 1 along x and y.
    pub pixel_offset: f64,
    /// `[height · width]`: colour over the background, in [0, 1].
    pub colors: Vec<DVec3>,
    /// `[height · width]`: true if more than half of the pixel shows matter (alpha above ½).
    pub covered: Vec<bool>,
    /// `[height · width]`: distance from the camera in scene units, where it is known and
    /// the pixel is opaque (alpha 255).
    pub distance: Vec<Option<f64>>,
}

impl TrueView {
    /// Reads every `stride`-th pixel along x and y of a frame's image and, if there are any, its depth map.
    ///
    /// # Errors
    /// If a file is missing or damaged, or its size differs from the camera's.
    pub fn read(
        frame: &Frame,
        depth: Option<&DepthFiles>,
        background: DVec3,
        pixel_offset: f64,
        stride: u32,
    ) -> Result<Self> {
        let image = PosedImage::read(&frame.image, frame.camera.resolution)?;
        let read = |depth: &DepthFiles| {
            DepthMap::read(&depth.path(&frame.name), depth.encoding, &frame.camera, pixel_offset)
                .map(|map| map.distance)
        };
        let truth = depth.map(read).transpose()?;
        let camera = frame.camera.strided(stride, pixel_offset);
        let [width, height] = camera.resolution;
        let full = |row: u32, column: u32| (row * stride * frame.camera.resolution[0] + column * stride) as usize;
        let pixels: Vec<usize> = (0..height).flat_map(|row| (0..width).map(move |c| full(row, c))).collect();
        Ok(Self {
            name: frame.name.clone(),
            camera,
            pixel_offset,
            colors: pixels.iter().map(|&i| image.over(i, background)).collect(),
            covered: pixels.iter().map(|&i| image.alpha(i) > 0.5).collect(),
            distance: pixels.iter().map(|&i| truth.as_ref()?[i].filter(|_| image.is_opaque(i))).collect(),
        })
    }

    /// [`TrueView::distance`] if depth maps that were taken for depth of this kind hold the other one.
    #[must_use]
    pub fn distance_if_not(&self, kind: DepthKind) -> Vec<Option<f64>> {
        let width = self.camera.resolution[0] as usize;
        let otherwise = |(i, distance): (usize, &Option<f64>)| {
            let [x, y] = [i % width, i / width].map(|n| n as f64 + self.pixel_offset);
            let stretch = |kind: DepthKind| kind.stretch(&self.camera, x, y);
            Some((*distance)? * stretch(kind.other()) / stretch(kind))
        };
        self.distance.iter().enumerate().map(otherwise).collect()
    }
}
