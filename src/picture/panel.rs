//! Images with a title and a labelled colour bar, arranged on a sheet.

use std::io::{Cursor, Write};
use std::path::Path;

use embedded_graphics::Pixel as GraphicsPixel;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_7X13;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};
use glam::DVec3;
use image::{ImageFormat, Rgb, RgbImage};

use crate::io::AtomicFile;
use crate::{Error, Result};

const FOREGROUND: Rgb<u8> = Rgb([30, 30, 30]);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
/// Colour of pixels without a value.
const NOTHING: Rgb<u8> = Rgb([225, 225, 225]);
const MARGIN: u32 = 10;
const TITLE: u32 = 20;
const BAR: u32 = 16;
/// Width of a tick and six characters.
const BAR_LABELS: u32 = 58;

/// A colour scale and the values at its ends.
#[derive(Clone)]
pub struct Bar {
    /// Values at the lower and the upper end.
    pub range: [f64; 2],
    /// Colours of the scale.
    pub gradient: colorous::Gradient,
}

impl Bar {
    fn color(&self, value: f64) -> Rgb<u8> {
        let share = (value - self.range[0]) / (self.range[1] - self.range[0]);
        if share.is_nan() {
            return NOTHING;
        }
        let color = self.gradient.eval_continuous(share.clamp(0.0, 1.0));
        Rgb([color.r, color.g, color.b])
    }
}

/// One picture of a sheet.
#[derive(Clone)]
pub struct Panel {
    /// Text above the picture.
    pub title: String,
    /// The picture.
    pub image: RgbImage,
    /// The scale, if colours stand for values.
    pub bar: Option<Bar>,
}

/// Makes a panel of colours, `[height · width]` in [0, 1].
#[must_use]
pub fn color_panel(title: &str, [width, height]: [u32; 2], colors: impl IntoIterator<Item = DVec3>) -> Panel {
    let bytes =
        colors.into_iter().flat_map(|c| c.to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8)).collect();
    let image = RgbImage::from_raw(width, height, bytes).expect("one colour per pixel");
    Panel { title: title.into(), image, bar: None }
}

/// Makes a panel of values, `[height · width]`. NaN is drawn grey.
#[must_use]
pub fn scalar_panel(title: &str, [width, height]: [u32; 2], values: impl IntoIterator<Item = f64>, bar: Bar) -> Panel {
    let bytes = values.into_iter().flat_map(|v| bar.color(v).0).collect();
    let image = RgbImage::from_raw(width, height, bytes).expect("one value per pixel");
    Panel { title: title.into(), image, bar: Some(bar) }
}

/// Writes rows of panels as one PNG.
///
/// # Errors
/// If the file cannot be written.
pub fn write_sheet(path: &Path, rows: &[Vec<Panel>]) -> Result<()> {
    stage_sheet(path, rows)?.commit()
}

/// Writes rows of panels as one PNG, in a file that appears when it is committed.
///
/// # Errors
/// As [`write_sheet`].
pub fn stage_sheet(path: &Path, rows: &[Vec<Panel>]) -> Result<AtomicFile> {
    let width_of = |panel: &Panel| {
        let bar = if panel.bar.is_some() { MARGIN / 2 + BAR + BAR_LABELS } else { 0 };
        (panel.image.width() + bar).max(7 * panel.title.len() as u32) + MARGIN
    };
    let row_height = |row: &Vec<Panel>| TITLE + row.iter().map(|p| p.image.height()).max().unwrap_or(0) + MARGIN;
    let width = rows.iter().map(|row| row.iter().map(width_of).sum::<u32>()).max().unwrap_or(0) + MARGIN;
    let height = rows.iter().map(row_height).sum::<u32>() + MARGIN;
    let mut sheet = Sheet(RgbImage::from_pixel(width, height, PAPER));
    let mut top = MARGIN;
    for row in rows {
        let mut left = MARGIN;
        for panel in row {
            sheet.text(&panel.title, left, top);
            image::imageops::replace(&mut sheet.0, &panel.image, i64::from(left), i64::from(top + TITLE));
            if let Some(bar) = &panel.bar {
                sheet.bar(bar, left + panel.image.width() + MARGIN / 2, top + TITLE, panel.image.height());
            }
            left += width_of(panel);
        }
        top += row_height(row);
    }
    let mut bytes = Cursor::new(Vec::new());
    sheet
        .0
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|e| Error::malformed(path, "picture", "an encodable PNG", e.to_string()))?;
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes.get_ref()).map_err(Error::io(path, "cannot write"))?;
    Ok(file)
}

/// An image on which text can be drawn.
struct Sheet(RgbImage);

impl Sheet {
    fn text(&mut self, text: &str, x: u32, y: u32) {
        let style = MonoTextStyle::new(&FONT_7X13, Rgb888::new(FOREGROUND[0], FOREGROUND[1], FOREGROUND[2]));
        let at = Point::new(x as i32, y as i32);
        Text::with_baseline(text, at, style, Baseline::Top).draw(self).expect("drawing on an image cannot fail");
    }

    /// Draws a vertical scale with five labelled ticks.
    fn bar(&mut self, bar: &Bar, left: u32, top: u32, height: u32) {
        let [low, high] = bar.range;
        for y in 0..height {
            let color = bar.color(high + (low - high) * f64::from(y) / f64::from(height - 1));
            (left..left + BAR).for_each(|x| self.0.put_pixel(x, top + y, color));
        }
        for tick in 0..5 {
            let share = f64::from(tick) / 4.0;
            let y = top + (share * f64::from(height - 1)) as u32;
            (left + BAR..left + BAR + 4).for_each(|x| self.0.put_pixel(x, y, FOREGROUND));
            let value = high + (low - high) * share;
            // Enough digits for the five ticks to differ.
            let is_plain = (0.1..1e4).contains(&low.abs().max(high.abs()));
            let text = if is_plain { format!("{value:.2}") } else { format!("{value:.2e}") };
            self.text(&text, left + BAR + 7, y.saturating_sub(6).clamp(top.saturating_sub(3), top + height - 10));
        }
    }
}

impl OriginDimensions for Sheet {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Sheet {
    type Color = Rgb888;
    type Error = std::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = GraphicsPixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> std::result::Result<(), Self::Error> {
        for GraphicsPixel(at, color) in pixels {
            if let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y))
                && x < self.0.width()
                && y < self.0.height()
            {
                self.0.put_pixel(x, y, Rgb([color.r(), color.g(), color.b()]));
            }
        }
        Ok(())
    }
}
