//! Words on pictures, in DejaVu Sans.

use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use image::{Rgb, RgbImage};

/// Height of a line, pixels.
pub const LINE: u32 = 20;
/// From the lowest to the highest that a letter reaches, pixels.
const SIZE: f32 = 19.0;

static TYPEFACE: LazyLock<FontRef> =
    LazyLock::new(|| FontRef::try_from_slice(dejavu::sans::regular()).expect("the typeface is part of the program"));

/// Letters of a line that begins at the left end of its baseline, and the place of the next one, pixels.
fn set(text: &str) -> (Vec<Glyph>, f32) {
    let typeface = TYPEFACE.as_scaled(PxScale::from(SIZE));
    let (mut glyphs, mut x) = (Vec::<Glyph>::new(), 0.0);
    for letter in text.chars() {
        let glyph = typeface.scaled_glyph(letter);
        x += glyphs.last().map_or(0.0, |before| typeface.kern(before.id, glyph.id));
        let advance = typeface.h_advance(glyph.id);
        glyphs.push(Glyph { position: point(x, 0.0), ..glyph });
        x += advance;
    }
    (glyphs, x)
}

/// Width of a line, pixels.
pub fn width_of_line(text: &str) -> u32 {
    set(text).1.ceil() as u32
}

/// Writes a line whose upper left corner is at x, y, on what is there. What does not fit is cut off.
pub fn write_line(image: &mut RgbImage, text: &str, [left, top]: [u32; 2], color: Rgb<u8>) {
    let baseline = top as f32 + TYPEFACE.as_scaled(SIZE).ascent().round();
    for mut glyph in set(text).0 {
        glyph.position += point(left as f32, baseline);
        let Some(outline) = TYPEFACE.outline_glyph(glyph) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|x, y, covered| {
            // Negative places wrap far beyond any picture.
            let [x, y] = [corner.x as i32 + x as i32, corner.y as i32 + y as i32].map(|at| at as u32);
            let Some(pixel) = image.get_pixel_mut_checked(x, y) else { return };
            for (channel, ink) in pixel.0.iter_mut().zip(color.0) {
                let mixed = f32::from(*channel) + covered.min(1.0) * (f32::from(ink) - f32::from(*channel));
                *channel = mixed.round() as u8;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: Rgb<u8> = Rgb([255; 3]);
    const INK: Rgb<u8> = Rgb([30; 3]);

    /// Columns and rows with ink.
    fn inked(image: &RgbImage) -> [Vec<u32>; 2] {
        let dark = |x: u32, y: u32| image.get_pixel(x, y)[0] < 200;
        [
            (0..image.width()).filter(|&x| (0..image.height()).any(|y| dark(x, y))).collect(),
            (0..image.height()).filter(|&y| (0..image.width()).any(|x| dark(x, y))).collect(),
        ]
    }

    #[test]
    fn a_line_fills_its_width_and_stays_in_its_height() {
        for text in ["log10 U \u{2264} 3.94", "deviation of depth (cm)", "0.25", "\u{221a}(Var + s\u{b2})", "gjpqy ÅÉ"]
        {
            let (left, top) = (7, 5);
            let mut image = RgbImage::from_pixel(400, LINE + 2 * top, PAPER);
            write_line(&mut image, text, [left, top], INK);
            let [columns, rows] = inked(&image);
            let end = left + width_of_line(text);
            assert!(columns[0] >= left && columns[0] <= left + 4, "{text}: {columns:?}");
            assert!(columns.iter().all(|&x| x < end) && columns.contains(&(end - 3)), "{text}: {columns:?}, {end}");
            assert!(rows.iter().all(|&y| (top..top + LINE).contains(&y)), "{text}: {rows:?}");
            // Every letter is there: the box that stands for a missing one is glyph 0.
            assert!(set(text).0.iter().all(|glyph| glyph.id.0 != 0), "{text}");
        }
        assert!(width_of_line("iii") < width_of_line("mmm"), "not all letters are of one width");
    }

    #[test]
    fn what_does_not_fit_is_cut_off() {
        let mut image = RgbImage::from_pixel(12, 9, PAPER);
        write_line(&mut image, "uncertain", [4, 0], INK);
        assert!(inked(&image)[0].iter().all(|&x| x >= 4) && !inked(&image)[0].is_empty());
        write_line(&mut image, "uncertain", [40, 40], INK);
    }
}
