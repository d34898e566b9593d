//! The binary files, little-endian.

use std::collections::HashMap;

use glam::DVec3;

use super::{Complaint, Lens, Parsed, RawCamera, RawImage, ScenePoint, finite, insert};

/// Bytes of a point in an image: two coordinates and the number of a point in space.
const POINT: u64 = 24;
/// Bytes of an image that shows a point in space: its number, and that of the point in it.
const SIGHTING: u64 = 8;

/// The rest of a file.
struct Bytes<'a> {
    rest: &'a [u8],
    /// What is being read, for messages.
    place: String,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: u64) -> Parsed<&'a [u8]> {
        let taken = usize::try_from(count).ok().and_then(|count| self.rest.split_at_checked(count));
        let Some((taken, rest)) = taken else {
            let found = format!("the end of the file after {}", self.rest.len());
            return Err(Complaint::new(&self.place, format!("{count} bytes"), found));
        };
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N as u64)?);
        Ok(array)
    }

    fn u64(&mut self) -> Parsed<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn u32(&mut self) -> Parsed<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn floats<const N: usize>(&mut self) -> Parsed<[f64; N]> {
        let mut floats = [0.0; N];
        for float in &mut floats {
            *float = self.array().map(f64::from_le_bytes)?;
        }
        Ok(floats)
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Parsed<String> {
        let end = self.rest.iter().position(|&byte| byte == 0);
        let Some(end) = end else {
            return Err(Complaint::new(&self.place, "a name that ends in a zero byte", "the end of the file"));
        };
        let text = self.take(end as u64 + 1)?;
        let text = String::from_utf8(text[..end].to_vec());
        text.map_err(|e| Complaint::new(&self.place, "a name in UTF-8", e.to_string()))
    }

    /// Checks that nothing is left.
    fn end(&self) -> Parsed<()> {
        match self.rest.len() {
            0 => Ok(()),
            more => Err(Complaint::new("end", "the end of the file", format!("{more} more bytes"))),
        }
    }
}

/// Reads `cameras.bin`.
pub fn cameras(file: &[u8]) -> Parsed<HashMap<u32, RawCamera>> {
    let mut bytes = Bytes { rest: file, place: "number of cameras".into() };
    let mut cameras = HashMap::new();
    for i in 0..bytes.u64()? {
        bytes.place = format!("camera at index {i}");
        let number = bytes.u32()?;
        let lens = Lens::numbered(bytes.array().map(i32::from_le_bytes)?).map_err(|mut complaint| {
            complaint.place = format!("camera {number}, model");
            complaint
        })?;
        let size = [bytes.u64()?, bytes.u64()?];
        let parameters = (0..lens.parameters()).map(|_| bytes.floats::<1>().map(|[v]| v)).collect::<Parsed<_>>()?;
        insert(&mut cameras, number, RawCamera { lens, size, parameters })?;
    }
    bytes.end()?;
    Ok(cameras)
}

/// Reads `images.bin`.
pub fn images(file: &[u8]) -> Parsed<Vec<RawImage>> {
    let mut bytes = Bytes { rest: file, place: "number of images".into() };
    let mut images = Vec::new();
    for i in 0..bytes.u64()? {
        bytes.place = format!("image at index {i}");
        bytes.u32()?;
        let [w, x, y, z, a, b, c] = bytes.floats()?;
        let camera = bytes.u32()?;
        let name = bytes.text()?;
        let points = bytes.u64()?;
        let Some(points) = points.checked_mul(POINT) else {
            return Err(Complaint::new(&bytes.place, "a number of points", points.to_string()));
        };
        bytes.take(points)?;
        images.push(RawImage { quaternion: [w, x, y, z], translation: [a, b, c], camera, name });
    }
    bytes.end()?;
    Ok(images)
}

/// Reads `points3D.bin`.
pub fn points(file: &[u8]) -> Parsed<Vec<ScenePoint>> {
    let mut bytes = Bytes { rest: file, place: "number of points".into() };
    let mut points = Vec::new();
    for i in 0..bytes.u64()? {
        bytes.place = format!("point at index {i}");
        bytes.u64()?;
        let position = finite(DVec3::from(bytes.floats()?), &bytes.place)?;
        let color = bytes.array()?;
        // The error of its projections.
        bytes.floats::<1>()?;
        let images = bytes.u64()?;
        let Some(sightings) = images.checked_mul(SIGHTING) else {
            return Err(Complaint::new(&bytes.place, "a number of images", images.to_string()));
        };
        bytes.take(sightings)?;
        points.push(ScenePoint { position, color });
    }
    bytes.end()?;
    Ok(points)
}
