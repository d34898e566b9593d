//! Lego's held-out views at half the size, as the splats of the data were trained.

use std::path::Path;

use image::{ImageBuffer, Luma, Rgba, RgbaImage};
use octobayes::{Error, Result};
use octobayes_data::{DepthKind, Views, write_transforms};
use octobayes_evaluation::DepthFiles;

/// Pixels of a side.
const SIDE: u32 = 200;

/// Writes means of 2 × 2 pixels, with depth where all four have some, and the cameras as `transforms_test.json`. The
/// views lie in `lego`.
pub fn write(lego: &Path, folder: &Path) -> Result<()> {
    let views = Views::read(&lego.join("transforms_test.json"), None)?;
    let mut cameras = Vec::new();
    for frame in &views.frames {
        let name = frame.name.trim_start_matches("./test/");
        let read = |path: String| {
            let path = lego.join(format!("test/{path}.png"));
            let image = image::open(&path);
            image.map_err(|e| Error::malformed(&path, "image", "one that can be read", e.to_string()))
        };
        let (image, depth) = (read(name.into())?.into_rgba8(), read(format!("{name}_depth_0001"))?.into_rgba8());
        let four = |x: u32, y: u32| [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[i, j]| [2 * x + i, 2 * y + j]);
        let color = RgbaImage::from_fn(SIDE, SIDE, |x, y| {
            let pixels = four(x, y).map(|[x, y]| image.get_pixel(x, y).0.map(f64::from));
            let alpha: f64 = pixels.iter().map(|p| p[3]).sum();
            let mean = |k: usize| pixels.iter().map(|p| p[k] * p[3]).sum::<f64>() / alpha.max(1.0);
            Rgba([mean(0), mean(1), mean(2), alpha / 4.0].map(|v| v.round() as u8))
        });
        let distance: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_fn(SIDE, SIDE, |x, y| {
            let values = four(x, y).map(|[x, y]| depth.get_pixel(x, y).0[0]);
            let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / 4.0;
            Luma([if values.contains(&0) { 0 } else { (mean * 257.0).round() as u16 }])
        });
        let path = |end: &str| folder.join(format!("{name}{end}.png"));
        let saved = color.save(path("")).and_then(|()| distance.save(path("_depth")));
        saved.map_err(|e| Error::malformed(folder, "image", "room to write it", e.to_string()))?;
        cameras.push((name.to_string(), frame.camera.resized([SIDE; 2])));
    }
    write_transforms(&folder.join("transforms_test.json"), &cameras)
}

/// The depth maps that [`write()`] wrote: eight units of distance over their range, near is bright.
#[must_use]
pub fn depth(folder: &Path) -> DepthFiles {
    DepthFiles {
        folder: Some(folder.into()),
        pattern: "{}_depth.png".into(),
        scale: Some([8.0, -8.0]),
        kind: DepthKind::Euclidean,
    }
}
