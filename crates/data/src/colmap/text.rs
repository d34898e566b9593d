//! The text files. Lines that begin with `#` are comments.

use std::collections::HashMap;
use std::str::{FromStr, SplitWhitespace};

use glam::DVec3;

use super::{Complaint, Lens, Parsed, RawCamera, RawImage, ScenePoint, finite, insert};

/// The words of a line.
struct Words<'a> {
    words: SplitWhitespace<'a>,
    /// Line number, from 1.
    line: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a str, line: usize) -> Self {
        Self { words: text.split_whitespace(), line }
    }

    fn complaint(&self, expected: &str, found: impl Into<String>) -> Complaint {
        Complaint::new(format!("line {}", self.line), expected, found)
    }

    fn word(&mut self, what: &str) -> Parsed<&'a str> {
        self.words.next().ok_or_else(|| self.complaint(what, "the end of the line"))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Parsed<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.complaint(what, word))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Parsed<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }
}

fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with('#')
}

/// Reads `cameras.txt`: a line `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]` for each.
pub fn cameras(text: &str) -> Parsed<HashMap<u32, RawCamera>> {
    let mut cameras = HashMap::new();
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !is_comment(line) && !line.trim().is_empty());
    for (number, line) in lines {
        let mut words = Words::new(line, number);
        let id = words.number("the number of a camera")?;
        let lens = Lens::named(words.word("a camera model")?).map_err(|mut complaint| {
            complaint.place = format!("camera {id}, model");
            complaint
        })?;
        let size = [words.number("a width")?, words.number("a height")?];
        let mut parameters = Vec::new();
        for _ in 0..lens.parameters() {
            parameters.push(words.number("a parameter of the lens")?);
        }
        if let Some(more) = words.words.next() {
            return Err(words.complaint("the end of the line after the lens's parameters", more));
        }
        insert(&mut cameras, id, RawCamera { lens, size, parameters })?;
    }
    Ok(cameras)
}

/// Reads `images.txt`: for each a line `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, and a line of points, which
/// may be empty or, in files by hand, missing.
pub fn images(text: &str) -> Parsed<Vec<RawImage>> {
    let mut images = Vec::new();
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !is_comment(line)).peekable();
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let mut words = Words::new(line, number);
        words.number::<u32>("the number of an image")?;
        let [w, x, y, z, a, b, c] = words.numbers("a quaternion and a translation")?;
        let camera = words.number("the number of a camera")?;
        words.word("the name of an image")?;
        let name = after(line.trim(), 9).to_string();
        images.push(RawImage { quaternion: [w, x, y, z], translation: [a, b, c], camera, name });
        match lines.peek() {
            Some((_, line)) if is_points(line) => _ = lines.next(),
            Some((_, line)) if is_image(line) => {}
            Some((number, line)) => {
                let expected = "the points of an image, three numbers each, or an empty line";
                return Err(Words::new(line, *number).complaint(expected, *line));
            }
            None => {}
        }
    }
    Ok(images)
}

/// Reads `points3D.txt`: for each a line `POINT3D_ID X Y Z R G B ERROR TRACK[]`.
pub fn points(text: &str) -> Parsed<Vec<ScenePoint>> {
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !is_comment(line) && !line.trim().is_empty());
    let point = |(number, line)| {
        let mut words = Words::new(line, number);
        words.number::<u64>("the number of a point")?;
        let position = finite(DVec3::from(words.numbers("a position")?), &format!("line {number}"))?;
        let mut color = [0; 3];
        for channel in &mut color {
            *channel = words.number("a colour from 0 to 255")?;
        }
        Ok(ScenePoint { position, color })
    };
    lines.map(point).collect()
}

/// A line of points: x, y and a whole number for each, or nothing.
fn is_points(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    let are_numbers = |words: &[&str]| words.iter().all(|word| word.parse::<f64>().is_ok());
    words.chunks(3).all(|point| match point {
        [x, y, number] => are_numbers(&[x, y]) && number.parse::<i64>().is_ok(),
        _ => false,
    })
}

/// A line of an image: its number, seven numbers, the number of a camera, and a name.
fn is_image(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    let is_whole = |i: usize| words[i].parse::<u32>().is_ok();
    words.len() > 9 && is_whole(0) && is_whole(8) && words[1..8].iter().all(|word| word.parse::<f64>().is_ok())
}

/// What follows a number of words, with the spaces within it.
fn after(line: &str, words: usize) -> &str {
    (0..words).fold(line, |rest, _| rest.split_once(char::is_whitespace).map_or("", |(_, rest)| rest.trim_start()))
}
