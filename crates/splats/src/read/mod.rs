//! Reads files of splats. Each is read whole and checked against the bytes present before anything is allocated.

mod checkpoint;
mod compressed;
mod header;
mod ply;
mod raw;
mod splat;
mod spz;

use std::path::Path;

pub use self::checkpoint::refuse_checkpoint;
pub(super) use self::ply::{DILATION, MODE, place_of_rest};
use super::Splats;
use octobayes::{Error, Result};

/// The constant spherical harmonic.
const CONSTANT: f64 = 0.282_094_791_773_878_14;

/// The coefficient of the constant harmonic that gives a colour in 0..1.
fn constant_of(color: f64) -> f32 {
    ((color - 0.5) / CONSTANT) as f32
}

/// Files of splats that are refused by name.
const CONVERTED: [&str; 6] = ["sog", "ksplat", "glb", "gltf", "lcc", "spx"];

fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

impl Splats {
    /// Returns true for a file that [`Splats::read`] reads or refuses in its own words, by its extension.
    #[must_use]
    pub fn is_splat_file(path: &Path) -> bool {
        let extension = extension(path);
        ["ply", "splat", "spz"].contains(&extension.as_str()) || CONVERTED.contains(&extension.as_str())
    }

    /// Reads a file of splats: `.ply` of the original code and of those that follow it, `.compressed.ply` of
    /// PlayCanvas, `.splat`, or `.spz` of versions 1 to 4.
    ///
    /// Axes are those of PLY files, x right, y down, z forward; `.spz` files are turned to these. Rotations are
    /// normalised. Splats with NaN, which training leaves now and then, are dropped; [`Splats::notes`] has them.
    ///
    /// # Errors
    /// If the file is missing or of another format, if it does not follow its format or has another length, or if more
    /// than 1 % of its splats have a number that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = extension(path);
        if CONVERTED.contains(&extension.as_str()) {
            let expected = "a `.ply`, `.splat` or `.spz` file; `splat-transform` (npm) converts others to `.ply`";
            return Err(Error::malformed(path, "format", expected, format!("a `.{extension}` file")));
        }
        let bytes = octobayes::io::read(path)?;
        match extension.as_str() {
            // Any 32 bytes are a splat, so that only the name identifies the format.
            "splat" => splat::read(path, &bytes),
            _ if bytes.starts_with(b"ply") => ply::read(path, &bytes),
            _ if spz::is_spz(&bytes) => spz::read(path, &bytes),
            _ => {
                let expected = "a file of splats: `.ply` (begins with `ply`), `.spz` (with `NGSP` or gzip) or `.splat`";
                let start = bytes[..bytes.len().min(4)].escape_ascii().to_string();
                Err(Error::malformed(path, "start", expected, format!("`{start}`")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_formats_are_refused_by_name() {
        for name in ["a.sog", "b.KSPLAT", "c.glb", "d.gltf"] {
            let path = Path::new(name);
            assert!(Splats::is_splat_file(path));
            let error = Splats::read(path).unwrap_err().to_string();
            assert!(error.contains("splat-transform"), "{error}");
        }
        assert!(["x.ply", "x.compressed.ply", "x.SPZ", "x.splat"].iter().all(|n| Splats::is_splat_file(Path::new(n))));
        assert!(["x.npz", "ply", "x", "x.json"].iter().all(|n| !Splats::is_splat_file(Path::new(n))));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ply");
        for bytes in [&b""[..], b"v 0 0 0\n", b"PK\x03\x04"] {
            std::fs::write(&path, bytes).unwrap();
            let error = Splats::read(&path).unwrap_err().to_string();
            assert!(error.contains("start: expected a file of splats"), "{error}");
        }
    }
}
