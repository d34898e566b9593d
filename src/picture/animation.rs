//! Pictures that move: GIF, and PNG with many frames.

use std::io::Write;
use std::path::Path;

use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbImage, RgbaImage};

use crate::io::AtomicFile;
use crate::{Error, Result};

/// Time for which a frame is shown, milliseconds. Browsers slow down GIFs that are faster than 50 frames a second.
const DELAY: u16 = 80;
/// How thoroughly GIF's 256 colours are chosen, from 1, the slowest, to 30.
const SPEED: i32 = 1;

/// Writes frames of one size as a picture that repeats for ever: `.gif`, or else PNG.
///
/// # Errors
/// If the file cannot be written.
pub fn write_animation(path: &Path, frames: Vec<RgbImage>) -> Result<()> {
    let mut bytes = Vec::new();
    let encoded = match path.extension().is_some_and(|e| e == "gif") {
        true => gif(&mut bytes, frames).map_err(|e| e.to_string()),
        false => png(&mut bytes, &frames).map_err(|e| e.to_string()),
    };
    encoded.map_err(|e| Error::malformed(path, "picture", "frames that can be encoded", e))?;
    let mut file = AtomicFile::create(path)?;
    file.write_all(&bytes).map_err(Error::io(path, "cannot write"))?;
    file.commit()
}

fn gif(out: &mut Vec<u8>, frames: Vec<RgbImage>) -> image::ImageResult<()> {
    let mut encoder = GifEncoder::new_with_speed(out, SPEED);
    encoder.set_repeat(Repeat::Infinite)?;
    for frame in frames {
        let opaque = RgbaImage::from_fn(frame.width(), frame.height(), |x, y| {
            let [r, g, b] = frame.get_pixel(x, y).0;
            image::Rgba([r, g, b, 255])
        });
        let delay = Delay::from_numer_denom_ms(u32::from(DELAY), 1);
        encoder.encode_frame(Frame::from_parts(opaque, 0, 0, delay))?;
    }
    Ok(())
}

fn png(out: &mut Vec<u8>, frames: &[RgbImage]) -> std::result::Result<(), png::EncodingError> {
    let Some(first) = frames.first() else { return Ok(()) };
    let mut encoder = png::Encoder::new(out, first.width(), first.height());
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_animated(frames.len() as u32, 0)?;
    encoder.set_frame_delay(DELAY, 1000)?;
    let mut writer = encoder.write_header()?;
    for frame in frames {
        writer.write_image_data(frame.as_raw())?;
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image::AnimationDecoder;

    use super::*;

    #[test]
    fn frames_come_back_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let colors = [[200, 0, 0], [0, 200, 0], [0, 0, 200]];
        let frames: Vec<RgbImage> = colors.iter().map(|&c| RgbImage::from_pixel(40, 30, image::Rgb(c))).collect();
        for name in ["a.gif", "a.png"] {
            let path = folder.path().join(name);
            write_animation(&path, frames.clone()).unwrap();
            let bytes = Cursor::new(std::fs::read(&path).unwrap());
            let read: Vec<Frame> = match name {
                "a.gif" => image::codecs::gif::GifDecoder::new(bytes).unwrap().into_frames().collect_frames().unwrap(),
                _ => {
                    let png = image::codecs::png::PngDecoder::new(bytes).unwrap().apng().unwrap();
                    png.into_frames().collect_frames().unwrap()
                }
            };
            assert_eq!(read.len(), 3, "{name}");
            for (frame, color) in read.iter().zip(colors) {
                let found = frame.buffer().get_pixel(20, 15).0;
                assert!((0..3).all(|k| found[k].abs_diff(color[k]) < 8), "{name}: {found:?} for {color:?}");
                assert_eq!(std::time::Duration::from(frame.delay()).as_millis(), u128::from(DELAY));
            }
        }
    }
}
