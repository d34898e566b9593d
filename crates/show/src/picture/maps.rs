//! Maps of numbers as grey pictures, for programs.

use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Writes a grey PNG of 16 bits, `[height · width]`.
///
/// # Errors
/// If the file cannot be written.
pub fn write_grey16(path: &Path, size: [u32; 2], values: &[u16]) -> Result<()> {
    // The encoder takes the order of bytes of this machine.
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
    write(path, size, &bytes, ExtendedColorType::L16)
}

/// Writes a grey PNG of 8 bits, `[height · width]`.
///
/// # Errors
/// If the file cannot be written.
pub fn write_grey8(path: &Path, size: [u32; 2], values: &[u8]) -> Result<()> {
    write(path, size, values, ExtendedColorType::L8)
}

fn write(path: &Path, [width, height]: [u32; 2], bytes: &[u8], kind: ExtendedColorType) -> Result<()> {
    let mut text = Vec::new();
    let failed = |e: image::ImageError| Error::setting("picture", "one that PNG can hold", e.to_string());
    PngEncoder::new(&mut text).write_image(bytes, width, height, kind).map_err(failed)?;
    AtomicFile::write(path, &text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.png");
        let values: Vec<u16> = (0..35).map(|i| i * 1871 + 1).collect();
        write_grey16(&path, [7, 5], &values).unwrap();
        let found = image::open(&path).unwrap();
        assert_eq!((found.width(), found.height(), found.color()), (7, 5, image::ColorType::L16));
        assert_eq!(found.into_luma16().into_raw(), values);
        write_grey8(&path, [2, 2], &[0, 64, 128, 255]).unwrap();
        assert_eq!(image::open(&path).unwrap().into_luma8().into_raw(), [0, 64, 128, 255]);
    }
}
