//! Images with a title and a labelled colour bar, arranged on a sheet.

use std::io::{Cursor, Write};
use std::path::Path;

use embedded_graphics::Pixel as GraphicsPixel;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_10X20;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};
use glam::DVec3;
use image::imageops::FilterType;
use image::{ImageFormat, Rgb, RgbImage};

use crate::io::AtomicFile;
use crate::{Error, Result};

const FOREGROUND: Rgb<u8> = Rgb([30, 30, 30]);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
/// Colour of pixels without a value.
const NOTHING: Rgb<u8> = Rgb([225, 225, 225]);
const MARGIN: u32 = 10;
/// Width and height of a character.
const CHARACTER: [u32; 2] = [10, 20];
/// Height of a title.
const TITLE: u32 = CHARACTER[1] + 4;
const BAR: u32 = 16;
/// Distance from the bar to its labels.
const TICK: u32 = 7;
/// Number of ticks with a number.
const TICKS: u32 = 5;
/// Least height of a bar with room for words between its numbers.
const ROOM_FOR_WORDS: u32 = 14 * CHARACTER[1];

/// Largest width to which small pictures are magnified.
const WIDEST: u32 = 1600;

/// A colour scale and the values at its ends.
#[derive(Clone)]
pub struct Bar {
    range: [f64; 2],
    gradient: colorous::Gradient,
    meaning: Option<Meaning>,
}

/// What the numbers of a scale mean.
#[derive(Clone)]
struct Meaning {
    low: [&'static str; 2],
    value: f64,
    words: &'static str,
}

impl Bar {
    /// A scale with the values at its lower and its upper end.
    #[must_use]
    pub fn new(range: [f64; 2], gradient: colorous::Gradient) -> Self {
        Self { range, gradient, meaning: None }
    }

    /// The same scale with words beside its numbers: two lines at the lower end, and one at `value`. There are none
    /// if `value` is not on the scale, or if the picture is too low for words between numbers.
    #[must_use]
    pub fn meaning(self, low: [&'static str; 2], value: f64, words: &'static str) -> Self {
        let on_scale = self.range[0] < value && value <= self.range[1];
        Self { meaning: on_scale.then_some(Meaning { low, value, words }), ..self }
    }

    /// Values at the ticks, from the upper end, as text.
    fn numbers(&self) -> Vec<String> {
        let [low, high] = self.range;
        // Enough digits for the ticks to differ.
        let is_plain = (0.1..1e4).contains(&low.abs().max(high.abs()));
        let value = |tick: u32| high + (low - high) * f64::from(tick) / f64::from(TICKS - 1);
        (0..TICKS).map(value).map(|v| if is_plain { format!("{v:.2}") } else { format!("{v:.2e}") }).collect()
    }

    /// Words to write, each with its distance from the upper end of a bar of this height, pixels.
    fn words(&self, height: u32) -> Vec<(u32, &'static str)> {
        let Some(meaning) = self.meaning.as_ref().filter(|_| height >= ROOM_FOR_WORDS) else { return Vec::new() };
        let line = CHARACTER[1];
        let share = (self.range[1] - meaning.value) / (self.range[1] - self.range[0]);
        let at = (share * f64::from(height - 1)) as u32;
        // Beside the nearest number, on the side where the value is.
        let nearest = (0..TICKS).map(|tick| tick * (height - 1) / (TICKS - 1)).min_by_key(|y| y.abs_diff(at));
        let at = match nearest.filter(|y| y.abs_diff(at) < line) {
            Some(0) => line,
            Some(y) if at >= y => y + line,
            Some(y) => y - line,
            None => at,
        };
        vec![(at, meaning.words), (height - 1 - 2 * line, meaning.low[0]), (height - 1 - line, meaning.low[1])]
    }

    /// Width of the bar with its labels, beside a picture of this height.
    fn width(&self, height: u32) -> u32 {
        let words = self.words(height);
        let numbers = self.numbers();
        let longest = numbers.iter().map(String::len).chain(words.iter().map(|word| word.1.len())).max().unwrap_or(0);
        MARGIN / 2 + BAR + TICK + CHARACTER[0] * longest as u32
    }

    fn color(&self, value: f64) -> Rgb<u8> {
        let share = (value - self.range[0]) / (self.range[1] - self.range[0]);
        if share.is_nan() {
            return NOTHING;
        }
        let color = self.gradient.eval_continuous(share.clamp(0.0, 1.0));
        Rgb([color.r, color.g, color.b])
    }
}

/// Colour of hatching: lighter than the background, and on no colour map.
const HATCHING: Rgb<u8> = Rgb([150, 150, 150]);

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

impl Panel {
    /// The same panel, hatched in grey at the pixels `[height · width]` for which `is_hatched` holds.
    #[must_use]
    pub fn hatched(mut self, is_hatched: impl Fn(usize) -> bool) -> Self {
        let width = self.image.width();
        for (i, pixel) in self.image.pixels_mut().enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            if (x + y) % 6 < 2 && is_hatched(i) {
                *pixel = HATCHING;
            }
        }
        self
    }
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
    let mut bytes = Cursor::new(Vec::new());
    draw_sheet(rows)
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|e| Error::malformed(path, "picture", "an encodable PNG", e.to_string()))?;
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes.get_ref()).map_err(Error::io(path, "cannot write"))?;
    Ok(file)
}

/// Draws rows of panels as one picture.
#[must_use]
pub fn draw_sheet(rows: &[Vec<Panel>]) -> RgbImage {
    let rows = &legible(rows);
    let width_of = |panel: &Panel| {
        let bar = panel.bar.as_ref().map_or(0, |bar| bar.width(panel.image.height()));
        (panel.image.width() + bar).max(CHARACTER[0] * panel.title.len() as u32) + MARGIN
    };
    let row_height = |row: &Vec<Panel>| TITLE + row.iter().map(|p| p.image.height()).max().unwrap_or(0) + MARGIN;
    // Panels of one column are as wide as its widest, so that they stand below each other.
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let column = |k: usize| rows.iter().filter_map(|row| row.get(k)).map(width_of).max().unwrap_or(0);
    let columns: Vec<u32> = (0..columns).map(column).collect();
    let width = columns.iter().sum::<u32>() + MARGIN;
    let height = rows.iter().map(row_height).sum::<u32>() + MARGIN;
    let mut sheet = Sheet(RgbImage::from_pixel(width, height, PAPER));
    let mut top = MARGIN;
    for row in rows {
        let mut left = MARGIN;
        for (panel, width) in row.iter().zip(&columns) {
            sheet.text(&panel.title, left, top);
            image::imageops::replace(&mut sheet.0, &panel.image, i64::from(left), i64::from(top + TITLE));
            if let Some(bar) = &panel.bar {
                sheet.bar(bar, left + panel.image.width() + MARGIN / 2, top + TITLE, panel.image.height());
            }
            left += width;
        }
        top += row_height(row);
    }
    sheet.0
}

/// The same rows, in which pictures that are too small for the words of their scales are magnified by whole numbers,
/// all by the same.
fn legible(rows: &[Vec<Panel>]) -> Vec<Vec<Panel>> {
    let sides = rows.iter().flatten().map(|panel| panel.image.dimensions());
    let [width, height] = sides.fold([1, u32::MAX], |[w, h], side| [w.max(side.0), h.min(side.1.max(1))]);
    let factor = ROOM_FOR_WORDS.div_ceil(height).min(WIDEST / width).max(1);
    let magnified = |panel: &Panel| {
        let [w, h] = [panel.image.width(), panel.image.height()].map(|side| factor * side);
        let image = image::imageops::resize(&panel.image, w, h, FilterType::Nearest);
        Panel { image, ..panel.clone() }
    };
    rows.iter().map(|row| row.iter().map(magnified).collect()).collect()
}

/// An image on which text can be drawn.
struct Sheet(RgbImage);

impl Sheet {
    fn text(&mut self, text: &str, x: u32, y: u32) {
        let style = MonoTextStyle::new(&FONT_10X20, Rgb888::new(FOREGROUND[0], FOREGROUND[1], FOREGROUND[2]));
        let at = Point::new(x as i32, y as i32);
        Text::with_baseline(text, at, style, Baseline::Top).draw(self).expect("drawing on an image cannot fail");
    }

    /// Draws a vertical scale with labelled ticks, and the words that explain it.
    fn bar(&mut self, bar: &Bar, left: u32, top: u32, height: u32) {
        let [low, high] = bar.range;
        for y in 0..height {
            let color = bar.color(high + (low - high) * f64::from(y) / f64::from(height - 1));
            (left..left + BAR).for_each(|x| self.0.put_pixel(x, top + y, color));
        }
        let mut label = |text: &str, y: u32| {
            let y = (top + y).saturating_sub(CHARACTER[1] / 2);
            self.text(text, left + BAR + TICK, y.clamp(top.saturating_sub(3), top + height - CHARACTER[1] + 4));
        };
        let place = |tick: u32| tick * (height - 1) / (TICKS - 1);
        for (tick, number) in (0..).zip(bar.numbers()) {
            label(&number, place(tick));
        }
        for (y, words) in bar.words(height) {
            label(words, y);
        }
        for tick in 0..TICKS {
            (left + BAR..left + BAR + 4).for_each(|x| self.0.put_pixel(x, top + place(tick), FOREGROUND));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_stand_between_numbers_and_only_where_they_are_true() {
        let inferno = |range| Bar::new(range, colorous::INFERNO);
        let bar = |range, value| inferno(range).meaning(["well", "constrained"], value, "never seen");
        for height in [280, 360, 800] {
            for value in [5.55, 5.4, 4.7, 4.6, 4.2, 3.0, 2.1] {
                let words = bar([2.0, 5.55], value).words(height);
                let ticks: Vec<u32> = (0..TICKS).map(|tick| tick * (height - 1) / (TICKS - 1)).collect();
                let (at, text) = words[0];
                assert_eq!(text, "never seen");
                // A line is 20 pixels high.
                assert!(ticks.iter().all(|tick| tick.abs_diff(at) >= 20 || value < 2.5), "{value} at {at}: {ticks:?}");
                let exact = (5.55 - value) / 3.55 * f64::from(height - 1);
                assert!((f64::from(at) - exact).abs() <= 21.0, "{value}: {at} instead of {exact}");
            }
        }
        // Columns stand below each other, and small pictures are magnified until there is room for words.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sheet.png");
        let panel = |title: &str, value: f64| {
            let bar = bar([2.0, 5.55], 5.55);
            scalar_panel(title, [40, 30], vec![value; 1200], bar)
        };
        let rows = [vec![panel("a", 2.0), panel("b", 5.55)], vec![panel(&"long ".repeat(20), 2.0), panel("d", 5.55)]];
        write_sheet(&path, &rows).unwrap();
        let sheet = image::open(&path).unwrap().to_rgb8();
        let yellow = rows[0][1].image.get_pixel(0, 0);
        let [first, second] = [0, 1].map(|half| {
            let row = (half * sheet.height() / 2..(half + 1) * sheet.height() / 2).step_by(5);
            let starts = row.filter_map(|y| {
                let is_long = |x: u32| (x..x + 20).all(|x| sheet.get_pixel(x, y) == yellow);
                (0..sheet.width() - 20).find(|&x| is_long(x))
            });
            starts.collect::<Vec<_>>()
        });
        assert!(first.len() * 5 >= ROOM_FOR_WORDS as usize - 10, "{} lines of five pixels", first.len());
        assert!(first.iter().chain(&second).all(|x| *x == first[0]), "{first:?} {second:?}");
        assert!(bar([2.0, 3.0], 5.55).words(360).is_empty(), "not on the scale");
        assert!(bar([2.0, 5.55], 5.55).words(200).is_empty(), "no room");
    }
}
