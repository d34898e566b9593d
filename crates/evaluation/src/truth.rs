//! What a held-out camera should see.

use glam::DVec3;

use octobayes::geometry::{Aabb, Camera};
use octobayes::{Error, Result};
use octobayes_data::{
    DepthEncoding, DepthKind, DepthMap, DepthReadings, Frame, LargestDepth, PosedImage, read_masks, read_object,
};

use super::kinds::{TrueParts, outlines};

/// How depth maps are read.
#[derive(Debug, Clone, Copy)]
pub struct DepthMeaning {
    /// Meaning of their values.
    pub encoding: DepthEncoding,
    /// The model's box: what lies far behind it is no depth of the scene ([`DepthMap::within`]).
    pub bounds: Aabb,
    /// What a depth changes by where it jumps, scene units.
    pub jump: f64,
}

impl DepthMeaning {
    /// Reads the depth map of a frame.
    ///
    /// # Errors
    /// If the frame has none, if the map is missing or damaged, or if its size differs from the camera's.
    pub fn read(&self, frame: &Frame, pixel_offset: f64) -> Result<DepthMap> {
        let none = || Error::setting(format!("depth map of frame `{}`", frame.name), "a file", "none");
        let path = frame.depth.as_ref().ok_or_else(none)?;
        let map = DepthMap::read(path, self.encoding, &frame.camera, pixel_offset)?;
        Ok(map.within(&self.bounds, &frame.camera))
    }
}

/// What a held-out camera should see, for some of its pixels.
#[derive(Debug, Clone)]
pub struct TrueView {
    /// The frame's `file_path`.
    pub name: String,
    /// A camera with exactly these pixels.
    pub camera: Camera,
    /// The camera of the whole image. These are every [`TrueView::stride`]-th of its pixels along x and y.
    pub whole: Camera,
    /// See [`TrueView::whole`].
    pub stride: u32,
    /// Position in a pixel that its ray passes through, 0 to 1 along x and y.
    pub pixel_offset: f64,
    /// `[height · width]`: colour over the background, in [0, 1].
    pub colors: Vec<DVec3>,
    /// `[height · width]`: true if the pixel is not masked.
    pub kept: Vec<bool>,
    /// `[height · width]`: true if more than half of the pixel shows matter (alpha above ½) and it is not masked.
    pub covered: Vec<bool>,
    /// `[height · width]`: distance from the camera in scene units, where it is known and the pixel is opaque (alpha
    /// 255) and not masked.
    pub distance: Vec<Option<f64>>,
    /// What the depth map holds at these pixels.
    pub readings: DepthReadings,
    /// What else is known of them.
    pub parts: TrueParts,
}

impl TrueView {
    /// Reads every `stride`-th pixel along x and y of a frame's image and, with `depth`, of its depth map, both at the
    /// size of the camera: a larger image becomes smaller.
    ///
    /// # Errors
    /// If a file is missing or damaged, or its size differs from the camera's.
    pub fn read(
        frame: &Frame,
        depth: Option<&DepthMeaning>,
        background: DVec3,
        pixel_offset: f64,
        stride: u32,
    ) -> Result<Self> {
        let image = PosedImage::of(frame)?;
        let mask = read_masks(std::slice::from_ref(frame))?.swap_remove(0);
        let truth = depth.map(|depth| depth.read(frame, pixel_offset)).transpose()?;
        let camera = frame.camera.strided(stride, pixel_offset);
        let [width, height] = camera.resolution;
        let full = |row: u32, column: u32| (row * stride * frame.camera.resolution[0] + column * stride) as usize;
        let pixels: Vec<usize> = (0..height).flat_map(|row| (0..width).map(move |c| full(row, c))).collect();
        let full_width = frame.camera.resolution[0] as usize;
        let keeps =
            |i: usize| mask.as_ref().is_none_or(|mask| mask.keeps((i % full_width) as u32, (i / full_width) as u32));
        let mut readings = DepthReadings::default();
        let measured = |&i: &usize| {
            let reading = truth.as_ref().filter(|_| image.is_opaque(i) && keeps(i))?.distance[i];
            readings.count(reading);
            reading.ok()
        };
        let distance = pixels.iter().map(measured).collect();
        let whole = frame.camera.resolution.map(|n| n as usize);
        let jump = depth.map_or(0.0, |depth| depth.jump);
        let outlines = truth.as_ref().map(|map| outlines(map, whole, |i| image.alpha(i) <= 0.5, jump));
        // Kinds are of pixels whose depth is judged.
        let shows_object = if depth.is_some() { read_object(frame)? } else { None };
        let object = shows_object
            .iter()
            .flat_map(|mask| pixels.iter().map(|&i| mask.keeps((i % full_width) as u32, (i / full_width) as u32)));
        let parts = TrueParts {
            outlines: outlines.iter().flat_map(|all| pixels.iter().map(|&i| all[i])).collect(),
            object: object.collect(),
            jump,
            // Of numbers rounded to steps.
            rounding: truth.as_ref().map_or(0.0, |map| map.step / 12_f64.sqrt()),
        };
        Ok(Self {
            name: frame.name.clone(),
            camera,
            whole: frame.camera,
            stride,
            pixel_offset,
            colors: pixels.iter().map(|&i| image.over(i, background)).collect(),
            kept: pixels.iter().map(|&i| keeps(i)).collect(),
            covered: pixels.iter().map(|&i| image.alpha(i) > 0.5 && keeps(i)).collect(),
            distance,
            readings,
            parts,
        })
    }

    /// [`TrueView::distance`] if depth maps that were taken for depth of this kind hold the other one.
    #[must_use]
    pub fn distance_if_not(&self, kind: DepthKind) -> Vec<Option<f64>> {
        let otherwise = |(i, distance): (usize, &Option<f64>)| {
            Some((*distance)? * self.stretch(kind.other(), i) / self.stretch(kind, i))
        };
        self.distance.iter().enumerate().map(otherwise).collect()
    }

    /// The largest depth of this kind.
    #[must_use]
    pub fn largest_depth(&self, kind: DepthKind) -> LargestDepth {
        let mut largest = LargestDepth::default();
        for (i, distance) in self.distance.iter().enumerate().filter_map(|(i, distance)| Some((i, (*distance)?))) {
            largest.count(LargestDepth { depth: distance / self.stretch(kind, i), pixels: 1 });
        }
        largest
    }

    /// Distance from the camera per depth of this kind at pixel `i`.
    fn stretch(&self, kind: DepthKind, i: usize) -> f64 {
        let width = self.camera.resolution[0] as usize;
        let [x, y] = [i % width, i / width].map(|n| n as f64 + self.pixel_offset);
        kind.stretch(&self.camera, x, y)
    }
}
