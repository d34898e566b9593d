//! PLY files, binary and little-endian. Crates for PLY hold every element as a map of properties; this only writes.

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::Vec3;

use octobayes::io::AtomicFile;
use octobayes::uncertainty::Estimate;
use octobayes::{Error, Result};

/// Properties of every point of a surface. CloudCompare takes what begins with `scalar_` as scalar fields without
/// asking.
pub const SURFACE: [(&str, &str); 12] = [
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("float", "nx"),
    ("float", "ny"),
    ("float", "nz"),
    ("uchar", "red"),
    ("uchar", "green"),
    ("uchar", "blue"),
    ("float", "scalar_log10_uncertainty"),
    ("float", "scalar_sigma"),
    ("float", "scalar_rays"),
];

/// A PLY file being written: its header first, then the rows of its elements.
pub struct PlyWriter {
    file: AtomicFile,
    path: PathBuf,
}

/// An element of a PLY file: its name, how many there are, and its properties with their types.
pub type Element<'a> = (&'a str, usize, &'a [(&'a str, &'a str)]);

impl PlyWriter {
    /// Starts a file of these elements, with comments for who reads it.
    pub fn create(path: &Path, comments: &[String], elements: &[Element]) -> Result<Self> {
        let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
        comments.iter().for_each(|comment| header.push_str(&format!("comment {comment}\n")));
        for (name, count, properties) in elements {
            header.push_str(&format!("element {name} {count}\n"));
            properties.iter().for_each(|(kind, name)| header.push_str(&format!("property {kind} {name}\n")));
        }
        header.push_str("end_header\n");
        let mut ply = Self { file: AtomicFile::create(path)?, path: path.to_path_buf() };
        ply.put(header.as_bytes())?;
        Ok(ply)
    }

    /// Appends bytes of a row.
    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(Error::io(&self.path, "cannot write"))
    }

    /// Appends `float` properties.
    pub fn floats(&mut self, values: impl IntoIterator<Item = f32>) -> Result<()> {
        values.into_iter().try_for_each(|value| self.put(&value.to_le_bytes()))
    }

    /// Appends the properties [`SURFACE`] of a point: position, normal, colour in [0, 1], and values of the field
    /// there.
    pub fn surface(&mut self, x: Vec3, normal: Vec3, color: Vec3, found: &Estimate) -> Result<()> {
        self.floats(x.to_array().into_iter().chain(normal.to_array()))?;
        self.put(&color.to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8))?;
        let rays = found.rays.map_or(f32::NAN, |rays| rays as f32);
        self.floats([found.uncertainty.log10() as f32, found.uncertainty as f32, rays])
    }

    /// Completes the file and gives it its name.
    pub fn finish(self) -> Result<()> {
        self.file.commit()
    }
}
