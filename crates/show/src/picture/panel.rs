//! Images with a title and a labelled colour bar, arranged on a sheet.

use std::io::{Cursor, Read, Write};
use std::path::Path;

use glam::DVec3;
use image::imageops::FilterType;
use image::{ImageFormat, Rgb, RgbImage};

use super::lettering::{LINE, width_of_line, write_line};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Bytes of a PNG before its second chunk: the signature and the size.
const START: usize = 33;
/// By which a sheet is recognised before it is replaced without being named.
const MADE_BY: &[u8] = b"Software\0octobayes";
const FOREGROUND: Rgb<u8> = Rgb([30, 30, 30]);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
/// Colour of pixels without a value.
const NO_VALUE: Rgb<u8> = Rgb([225, 225, 225]);
const MARGIN: u32 = 10;
/// Height of a title.
const TITLE: u32 = LINE + 4;
const BAR: u32 = 16;
/// Distance from the bar to its labels.
const TICK: u32 = 7;
/// How far the numbers at the ends of a bar are moved inwards, so that they stay beside it.
const INWARDS: u32 = 6;
/// Number of ticks with a number.
const TICKS: u32 = 5;
/// Least height of a bar with room for words between its numbers.
const ROOM_FOR_WORDS: u32 = 14 * LINE;

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
        let share = (self.range[1] - meaning.value) / (self.range[1] - self.range[0]);
        let at = (share * f64::from(height - 1)) as u32;
        // Beside the nearest number, on the side where the value is.
        let nearest = (0..TICKS).map(|tick| tick * (height - 1) / (TICKS - 1)).min_by_key(|y| y.abs_diff(at));
        let at = match nearest.filter(|y| y.abs_diff(at) < LINE) {
            Some(0) => LINE + INWARDS,
            Some(y) if at >= y => y + LINE,
            Some(y) => y - LINE,
            None => at,
        };
        let low = |lines: u32| height - 1 - INWARDS - lines * LINE;
        vec![(at, meaning.words), (low(2), meaning.low[0]), (low(1), meaning.low[1])]
    }

    /// Width of the bar with its labels, beside a picture of this height.
    fn width(&self, height: u32) -> u32 {
        let words = self.words(height);
        let numbers = self.numbers();
        let lines = numbers.iter().map(String::as_str).chain(words.iter().map(|word| word.1));
        MARGIN / 2 + BAR + TICK + lines.map(width_of_line).max().unwrap_or(0)
    }

    fn color(&self, value: f64) -> Rgb<u8> {
        let share = (value - self.range[0]) / (self.range[1] - self.range[0]);
        if share.is_nan() {
            return NO_VALUE;
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

/// Writes rows of panels as one PNG, with a line of text below them.
///
/// # Errors
/// As [`write_sheet`].
pub fn write_noted_sheet(path: &Path, rows: &[Vec<Panel>], note: &str) -> Result<()> {
    stage_picture(path, &noted(&draw_sheet(rows), note))?.commit()
}

/// The picture with a line of text below it.
fn noted(sheet: &RgbImage, note: &str) -> RgbImage {
    let width = sheet.width().max(width_of_line(note) + 2 * MARGIN);
    let mut taller = RgbImage::from_pixel(width, sheet.height() + LINE, PAPER);
    image::imageops::replace(&mut taller, sheet, 0, 0);
    write_line(&mut taller, note, [MARGIN, sheet.height() - MARGIN / 2], FOREGROUND);
    taller
}

/// Writes rows of panels as one PNG, in a file that appears when it is committed.
///
/// # Errors
/// As [`write_sheet`].
pub fn stage_sheet(path: &Path, rows: &[Vec<Panel>]) -> Result<AtomicFile> {
    stage_picture(path, &draw_sheet(rows))
}

fn stage_picture(path: &Path, picture: &RgbImage) -> Result<AtomicFile> {
    let mut bytes = Cursor::new(Vec::new());
    picture
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|e| Error::malformed(path, "picture", "an encodable PNG", e.to_string()))?;
    let mut file = AtomicFile::create(path)?;
    // The text comes behind the signature and the size.
    let (start, rest) = bytes.get_ref().split_at(START);
    let mut chunk = vec![0, 0, 0, MADE_BY.len() as u8];
    chunk.extend(b"tEXt");
    chunk.extend(MADE_BY);
    chunk.extend(crc32fast::hash(&chunk[4..]).to_be_bytes());
    [start, &chunk, rest].iter().try_for_each(|part| file.write_all(part)).map_err(Error::io(path, "cannot write"))?;
    Ok(file)
}

/// Whether a file is a sheet that this program wrote.
#[must_use]
pub fn is_own_sheet(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let read =
        octobayes::io::open(path).map(|file| file.take((START + 8 + MADE_BY.len()) as u64).read_to_end(&mut bytes));
    matches!(read, Ok(Ok(_))) && bytes.ends_with(MADE_BY)
}

/// Draws rows of panels as one picture.
#[must_use]
pub fn draw_sheet(rows: &[Vec<Panel>]) -> RgbImage {
    let rows = &legible(rows);
    let width_of = |panel: &Panel| {
        let bar = panel.bar.as_ref().map_or(0, |bar| bar.width(panel.image.height()));
        (panel.image.width() + bar).max(width_of_line(&panel.title)) + MARGIN
    };
    let row_height = |row: &Vec<Panel>| TITLE + row.iter().map(|p| p.image.height()).max().unwrap_or(0) + MARGIN;
    // Panels of one column are as wide as its widest, so that they stand below each other.
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let column = |k: usize| rows.iter().filter_map(|row| row.get(k)).map(width_of).max().unwrap_or(0);
    let columns: Vec<u32> = (0..columns).map(column).collect();
    let width = columns.iter().sum::<u32>() + MARGIN;
    let height = rows.iter().map(row_height).sum::<u32>() + MARGIN;
    let mut sheet = RgbImage::from_pixel(width, height, PAPER);
    let mut top = MARGIN;
    for row in rows {
        let mut left = MARGIN;
        for (panel, width) in row.iter().zip(&columns) {
            write_line(&mut sheet, &panel.title, [left, top], FOREGROUND);
            image::imageops::replace(&mut sheet, &panel.image, i64::from(left), i64::from(top + TITLE));
            if let Some(bar) = &panel.bar {
                draw_bar(&mut sheet, bar, [left + panel.image.width() + MARGIN / 2, top + TITLE], panel.image.height());
            }
            left += width;
        }
        top += row_height(row);
    }
    sheet
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

/// Draws a vertical scale with labelled ticks, and the words that explain it.
fn draw_bar(sheet: &mut RgbImage, bar: &Bar, [left, top]: [u32; 2], height: u32) {
    let [low, high] = bar.range;
    for y in 0..height {
        let color = bar.color(high + (low - high) * f64::from(y) / f64::from(height - 1));
        (left..left + BAR).for_each(|x| sheet.put_pixel(x, top + y, color));
    }
    let place = |tick: u32| tick * (height - 1) / (TICKS - 1);
    let numbers = bar.numbers();
    let labels = (0..).zip(&numbers).map(|(tick, number)| (place(tick), number.as_str())).chain(bar.words(height));
    for (y, label) in labels {
        let y = (top + y).saturating_sub(LINE / 2);
        // Not `clamp`: a bar may be lower than a line.
        let y = y.min((top + height).saturating_sub(INWARDS + LINE / 2)).max((top + INWARDS).saturating_sub(LINE / 2));
        write_line(sheet, label, [left + BAR + TICK, y], FOREGROUND);
    }
    for tick in 0..TICKS {
        (left + BAR..left + BAR + 4).for_each(|x| sheet.put_pixel(x, top + place(tick), FOREGROUND));
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
                // Beside the upper end, whose number is moved inwards, words are, too.
                let most = if exact < f64::from(LINE) { LINE + INWARDS + 1 } else { LINE + 1 };
                assert!((f64::from(at) - exact).abs() <= f64::from(most), "{value}: {at} instead of {exact}");
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
        assert!(is_own_sheet(&path) && !is_own_sheet(folder.path()) && !is_own_sheet(&folder.path().join("none")));
        let sheet = image::open(&path).unwrap().to_rgb8();
        sheet.save(folder.path().join("other.png")).unwrap();
        assert!(!is_own_sheet(&folder.path().join("other.png")), "a picture of another program");
        write_noted_sheet(&path, &rows, "a line below").unwrap();
        let noted = image::open(&path).unwrap().to_rgb8();
        assert_eq!(noted.dimensions(), (sheet.width(), sheet.height() + LINE));
        let ink = |picture: &RgbImage| picture.rows().skip(sheet.height() as usize - 9).flatten().any(|p| p.0[0] < 128);
        assert!(ink(&noted) && !ink(&sheet), "the line stands below the panels");
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
        // A picture as low as a line of pixels, and as wide as a sheet.
        let low = scalar_panel("low", [1600, 1], vec![3.0; 1600], bar([2.0, 5.55], 5.55));
        assert!(draw_sheet(&[vec![low]]).width() > 1600);
        assert!(bar([2.0, 3.0], 5.55).words(360).is_empty(), "not on the scale");
        assert!(bar([2.0, 5.55], 5.55).words(200).is_empty(), "no room");
    }
}
