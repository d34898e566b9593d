//! Whether a model shows the images that lie beside its cameras: cameras of another scene, or poses in other axes, give
//! a field that looks as good as any.

use glam::{DVec3, Vec3};

use octobayes::geometry::{Camera, NamedCamera, inverted, opencv};
use octobayes::io::evenly;
use octobayes::metrics::psnr;
use octobayes::monitor::{Monitor, check};
use octobayes::render::Renderer;
use octobayes::{Error, Result};
use octobayes_data::{Frame, PosedImage, SampledImage, has_shape, measure, read_masks};

/// Most images that are read, spread over the cameras: one of 12 megapixels takes a tenth of a second.
const IMAGES: usize = 8;
/// Pixels of each that are rendered. The mean squared error of 512 pixels is known to about a tenth, 0.5 dB.
const PIXELS: usize = 64;
/// A model that shows its images worse is worth a warning, dB. Models trained to the end have 20 and more, and a plain
/// colour for all images often has 10.
const LOW_PSNR: f64 = 15.0;
/// The same for splats, dB. Their images fit less well at every size but the one that they were trained at: 32 dB there
/// became 22 to 24 dB at half and at twice that size.
const LOW_PSNR_OF_SPLATS: f64 = 20.0;
/// A model that shows its images worse does not show them at all, dB. Two unrelated images have about 8: the root mean
/// square difference of two values drawn from [0, 1] is 0.41.
const UNRELATED_PSNR: f64 = 8.0;
/// What another background or other poses must gain to be named, dB: half of the squared error.
const MORE: f64 = 3.0;

/// The same if the images have alpha, dB, and the PSNR beyond which their rounding decides.
const MORE_WITH_ALPHA: f64 = 1.0;
const EXACT: f64 = 40.0;
/// What one background must gain over the other to be taken, dB.
const CLEAR: f64 = 1.0;

/// Mean opacity of the pixels from which other poses see the model.
const MIN_OPACITY: f64 = 0.05;

/// The backgrounds that are tried beside the tracer's.
const BACKGROUNDS: [(&str, Vec3); 2] = [("white", Vec3::ONE), ("black", Vec3::ZERO)];

/// How well a model shows the images that lie beside its cameras.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImageCheck {
    /// Number of images that were compared.
    pub images: usize,
    /// Number of their pixels that were rendered.
    pub pixels: usize,
    /// PSNR over these pixels, dB.
    pub psnr: f64,
    /// PSNR over these pixels in front of white and of black, dB.
    pub backgrounds: [f64; 2],
    /// The background that shows the images best, white or black, and its PSNR, if it gains much.
    pub background: Option<(&'static str, f64)>,
    /// The reading of the poses that shows the images best, and its PSNR, if it gains much.
    pub poses: Option<(&'static str, f64)>,
    /// Sizes of the first camera and its image whose sides have different ratios, pixels.
    pub shapes: Option<[[u32; 2]; 2]>,
    /// Number of images of one colour, which are placeholders of pictures and not compared.
    pub blank: usize,
    /// Number of images that cannot be compared, and why the first of them cannot.
    pub unread: Option<(usize, String)>,
    /// Whether the model is one of splats or the like, whose images are worse in any other size than that of their
    /// training.
    pub depends_on_pixels: bool,
    /// Whether the model was trained on some of these very cameras: then it can only be a poor model.
    pub is_trained_on: bool,
}

/// The frames with an image.
fn beside(frames: &[Frame]) -> Vec<&Frame> {
    frames.iter().filter(|frame| frame.image.is_file()).collect()
}

/// Those of them that are compared.
fn chosen<'a>(beside: &[&'a Frame]) -> Vec<&'a Frame> {
    let used = beside.len().min(IMAGES);
    (0..used).map(|i| beside[(2 * i + 1) * beside.len() / (2 * used)]).collect()
}

/// Memory that it takes to decode the largest of the images that are compared, bytes.
#[must_use]
pub fn memory_of_images(frames: &[Frame]) -> u64 {
    let chosen = chosen(&beside(frames)).into_iter();
    chosen.filter_map(|frame| measure(&frame.image, "image").ok()).map(|(_, bytes)| bytes).max().unwrap_or(0)
}

/// Some pixels of an image, and the camera that took it.
struct Shown {
    camera: Camera,
    /// Size of the image, pixels.
    size: [u32; 2],
    /// Image points, pixels of the camera; and the same pixels of the image.
    points: Vec<[f64; 2]>,
    image: SampledImage,
}

/// How the poses of a camera file may have been meant.
type Reading = fn(&Camera) -> Camera;

/// What a tracer renders without what lies behind: colour, and the share of the background that passes.
type Rendered = Vec<(DVec3, f64)>;

/// Compares some pixels of the images that lie beside `frames` with what the model shows there. `None` without images.
/// An image that takes more than `room` bytes to decode is counted as unread. Images of another size than their
/// camera's are compared at the same place relative to their sides; masked pixels and images of one colour are left
/// out. `trained` are the model's own training cameras, if it stores them.
///
/// The same pixels every time, whatever the number of threads.
///
/// # Errors
/// [`Error::Interrupted`], or if the model cannot render a camera; images that cannot be read are counted.
pub fn check_images(
    renderer: &dyn Renderer,
    trained: &[NamedCamera],
    frames: &[Frame],
    pixel_offset: f64,
    room: Option<u64>,
    monitor: &dyn Monitor,
) -> Result<Option<ImageCheck>> {
    let beside = beside(frames);
    let length = renderer.bounds().longest_edge();
    let is_stored = |frame: &&Frame| trained.iter().any(|known| known.camera.is_like(&frame.camera, length));
    // One at a time, so that no more than one is held, as the plan foresees.
    let read = |frame: &Frame| check(monitor).map(|()| Shown::read(frame, pixel_offset, room));
    let read: Vec<Result<Shown>> = chosen(&beside).into_iter().map(read).collect::<Result<_>>()?;
    let why: Vec<String> = read.iter().filter_map(|read| read.as_ref().err()).map(ToString::to_string).collect();
    let unread = why.first().map(|first| (why.len(), first.clone()));
    let read: Vec<Shown> = read.into_iter().filter_map(Result::ok).filter(|shown| !shown.points.is_empty()).collect();
    let (blank, shown): (Vec<Shown>, Vec<Shown>) = read.into_iter().partition(|shown| shown.image.is_of_one_color);
    let pixels: usize = shown.iter().map(|shown| shown.points.len()).sum();
    let mut found = ImageCheck {
        images: shown.len(),
        pixels,
        psnr: f64::NAN,
        shapes: shown.iter().find_map(Shown::shapes),
        blank: blank.len(),
        unread,
        depends_on_pixels: renderer.marched().is_none(),
        is_trained_on: beside.iter().any(is_stored),
        ..ImageCheck::default()
    };
    if pixels == 0 {
        return Ok((found.unread.is_some() || found.blank > 0).then_some(found));
    }

    let rendered = render(renderer, &shown, |camera| *camera, monitor)?;
    let background = renderer.background();
    found.psnr = psnr_over(&shown, &rendered, background);
    let best = |found: &mut dyn Iterator<Item = (&'static str, f64)>| found.max_by(|a, b| a.1.total_cmp(&b.1));
    let fair = found.fair();
    let gains = |(_, other): &(&str, f64)| *other >= (found.psnr + MORE).max(fair);
    found.backgrounds = BACKGROUNDS.map(|(_, color)| psnr_over(&shown, &rendered, color.as_dvec3()));
    let has_alpha = shown.iter().any(|shown| (0..shown.points.len()).any(|i| !shown.image.pixels.is_opaque(i)));
    // Images with alpha fit nearly as well in front of a background that the training never had.
    let gains_with_alpha = |(_, other): &(&str, f64)| {
        has_alpha && found.psnr < EXACT && *other >= (found.psnr + MORE_WITH_ALPHA).max(fair)
    };
    let others = BACKGROUNDS.iter().zip(found.backgrounds).map(|((name, _), psnr)| (*name, psnr));
    found.background = best(&mut others.into_iter()).filter(|other| gains(other) || gains_with_alpha(other));
    if found.psnr < fair && found.background.is_none() {
        let readings: [(&str, Reading); 3] = [
            ("OpenCV axes (y down, looking along +z) in place of OpenGL's", opencv),
            ("world-to-camera matrices in place of camera-to-world", |camera| inverted(camera)[0]),
            ("world-to-camera matrices with OpenCV axes", |camera| inverted(camera)[1]),
        ];
        let mut others = Vec::new();
        for (name, reading) in readings {
            let rendered = render(renderer, &shown, reading, monitor)?;
            // Cameras that see nothing show blank images exactly.
            if rendered.iter().map(|(_, passed)| 1.0 - passed).sum::<f64>() >= MIN_OPACITY * pixels as f64 {
                others.push((name, psnr_over(&shown, &rendered, background)));
            }
        }
        found.poses = best(&mut others.into_iter()).filter(gains);
    }
    Ok(Some(found))
}

impl Shown {
    fn read(frame: &Frame, pixel_offset: f64, room: Option<u64>) -> Result<Self> {
        let camera = frame.camera;
        let (size, bytes) = measure(&frame.image, "image")?;
        if let Some(room) = room.filter(|&room| bytes > room) {
            let [bytes, room] = [bytes, room].map(|bytes| bytes.div_ceil(1_000_000));
            let expected = format!("at most {room} MB to decode it, what the memory budget leaves");
            return Err(Error::malformed(&frame.image, "image", expected, format!("{bytes} MB")));
        }
        let mask = read_masks(std::slice::from_ref(frame))?.swap_remove(0);
        let place = |i: usize| -> [f64; 2] {
            std::array::from_fn(|axis| (evenly(i)[axis] * f64::from(camera.resolution[axis])).floor())
        };
        // Pixel of an image of another size whose ray passes nearest.
        let in_image = |[x, y]: &[f64; 2]| {
            [(x, 0), (y, 1)].map(|(at, axis)| {
                let [of, sides] = [camera.resolution, size].map(|sides| f64::from(sides[axis]));
                ((at + pixel_offset) * sides / of - pixel_offset).round().clamp(0.0, sides - 1.0) as u32
            })
        };
        let is_kept = |[x, y]: &[f64; 2]| mask.as_ref().is_none_or(|mask| mask.keeps(*x as u32, *y as u32));
        let points: Vec<[f64; 2]> = (0..PIXELS).map(place).filter(is_kept).collect();
        let pixels: Vec<[u32; 2]> = points.iter().map(in_image).collect();
        let image = PosedImage::sample(&frame.image, size, &pixels)?;
        let points = points.into_iter().map(|at| at.map(|at| at + pixel_offset)).collect();
        Ok(Self { camera, size, points, image })
    }

    /// Sizes of camera and image, if one is not the other resized: their ratios differ by more than rounding explains.
    fn shapes(&self) -> Option<[[u32; 2]; 2]> {
        let sizes = [self.camera.resolution, self.size];
        (!has_shape(sizes[0], sizes[1])).then_some(sizes)
    }
}

/// What is rendered at the images' pixels, if other cameras took them.
fn render(
    renderer: &dyn Renderer,
    shown: &[Shown],
    taken_by: impl Fn(&Camera) -> Camera,
    monitor: &dyn Monitor,
) -> Result<Rendered> {
    let background = renderer.background();
    let views: Vec<(Camera, Vec<[f64; 2]>)> =
        shown.iter().map(|shown| (taken_by(&shown.camera), shown.points.clone())).collect();
    let alone = renderer.points(&views, monitor)?.pixels.into_iter().map(|pixel| {
        let passed = 1.0 - pixel.opacity;
        (pixel.color - passed * background, passed)
    });
    Ok(alone.collect())
}

/// PSNR of what was rendered, with both model and images over a background.
fn psnr_over(shown: &[Shown], rendered: &[(DVec3, f64)], background: DVec3) -> f64 {
    let pixels = |shown: &Shown| (0..shown.points.len()).map(|i| shown.image.pixels.over(i, background)).collect();
    let truth: Vec<DVec3> = shown.iter().flat_map::<Vec<DVec3>, _>(pixels).collect();
    let found: Vec<DVec3> = rendered.iter().map(|(color, passed)| *color + *passed * background).collect();
    psnr(&found, &truth)
}

impl ImageCheck {
    /// Whether the model shows nothing of the images.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.psnr < UNRELATED_PSNR
    }

    /// The PSNR below which a model is worth a warning, dB.
    fn fair(&self) -> f64 {
        if self.depends_on_pixels { LOW_PSNR_OF_SPLATS } else { LOW_PSNR }
    }

    /// Whether the model shows the images worse than a trained one should.
    #[must_use]
    pub fn is_poor(&self) -> bool {
        self.psnr < self.fair()
    }

    /// White or black, if one shows the images fairly and clearly better than the other; and its PSNR and the other's.
    #[must_use]
    pub fn clear_background(&self) -> Option<(Vec3, [f64; 2])> {
        let [white, black] = self.backgrounds;
        let (color, psnr, other) = if white > black { (Vec3::ONE, white, black) } else { (Vec3::ZERO, black, white) };
        (psnr >= LOW_PSNR && psnr - other >= CLEAR).then_some((color, [psnr, other]))
    }

    /// What was measured of splats, for users to compare with the PSNR of the training.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        (self.depends_on_pixels && self.images > 0).then(|| {
            format!(
                "the splats show the images beside the cameras with {}; less than in training hints at another size \
                 (--resolution)",
                self.measured()
            )
        })
    }

    /// What was measured, as JSON.
    #[must_use]
    pub fn report(&self) -> serde_json::Value {
        let Self { images, pixels, psnr, .. } = self;
        serde_json::json!({ "images": images, "pixels": pixels, "psnr": psnr.is_finite().then_some(psnr) })
    }

    /// Describes what was measured.
    #[must_use]
    pub fn measured(&self) -> String {
        let Self { images, pixels, psnr, .. } = self;
        let images = if *images == 1 { "1 image".into() } else { format!("{images} images") };
        format!("{psnr:.1} dB over {pixels} pixels of {images}")
    }

    /// The likely causes, if the images are poorly shown.
    #[must_use]
    pub fn causes(&self) -> String {
        if let Some((name, psnr)) = self.background {
            return format!("another background than the images' (with {name}: {psnr:.1} dB)");
        }
        if let Some((name, psnr)) = self.poses {
            return format!("{name} (read so: {psnr:.1} dB)");
        }
        let mut causes = Vec::new();
        if let Some([[w, h], [image_w, image_h]]) = self.shapes {
            causes.push(format!("images of {image_w} x {image_h} pixels for cameras of {w} x {h}"));
        }
        if self.depends_on_pixels {
            causes.push("another image size than the splats were trained at (--resolution)".into());
            causes.push("a frame that the export normalised (nerfstudio, gsplat)".into());
        }
        if self.is_trained_on {
            causes.push("a model that was hardly trained".into());
        } else {
            causes.push("cameras or images of another scene".into());
            causes.push("other axes, units or background than the model's".into());
        }
        causes.join(", or ")
    }

    /// Warnings: that the images are poorly reproduced, that another background shows them much better, that some
    /// cannot be compared.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some((count, why)) = &self.unread {
            let images = if *count == 1 { "1 image".into() } else { format!("{count} images") };
            warnings.push(format!("the model is not compared with {images} beside the cameras: {why}"));
        }
        if self.blank > 0 {
            let images = if self.blank == 1 { "1 image".into() } else { format!("{} images", self.blank) };
            warnings.push(format!("the model is not compared with {images} of one colour beside the cameras"));
        }
        let (measured, causes, fair) = (self.measured(), self.causes(), self.fair());
        if self.is_poor() {
            warnings.push(format!(
                "renders of the model hardly match the images beside the cameras: {measured}, {fair:.0} dB would be \
                 fair; likely causes: {causes}"
            ));
        } else if self.background.is_some() {
            warnings.push(format!(
                "renders match the images beside the cameras poorly: {measured}; likely cause: {causes}"
            ));
        }
        warnings
    }

    /// Refuses cameras whose images the model does not show at all, unless it was trained on some of them.
    ///
    /// # Errors
    /// If that is so.
    pub fn refuse(&self) -> Result<()> {
        if !self.is_empty() || self.is_trained_on {
            return Ok(());
        }
        let expected = format!(
            "images that the model shows with at least {UNRELATED_PSNR:.0} dB; likely causes: {}",
            self.causes()
        );
        Err(Error::setting(
            "images beside the cameras",
            expected,
            format!("{} (override with --force)", self.measured()),
        ))
    }
}
