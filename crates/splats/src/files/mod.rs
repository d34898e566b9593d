//! Files of splats. Each is read whole and checked against the bytes present before anything is allocated.

mod checkpoint;
mod compressed;
mod header;
mod ply;
mod raw;
mod splat;
mod spz;

use std::path::Path;

pub use self::checkpoint::refuse_checkpoint;
use super::{RenderMode, Splats};
use glam::Vec3;
use octobayes::field::harmonics::C0;
use octobayes::{Error, Result};

/// The coefficient of the constant harmonic that gives a colour in 0..1.
pub(super) fn constant_of(color: f64) -> f32 {
    ((color - 0.5) / C0) as f32
}

/// Red, green and blue of the constant harmonic, 0 to 1 unless it is beyond what pictures have.
fn color_of(sh: &[f32]) -> Vec3 {
    Vec3::new(sh[0], sh[1], sh[2]).map(|v| (0.5 + C0 * f64::from(v)) as f32)
}

/// The nearest of 256 steps from 0 to 1.
fn byte_of(value: f32) -> u8 {
    (value * 255.0).round().clamp(0.0, 255.0) as u8
}

/// Which of a rotation's entries is the largest, and the other three in their order, with the sign that makes it positive:
/// it follows from them.
fn without_largest(q: [f32; 4]) -> (usize, [f32; 3]) {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    (largest, [0, 1, 2].map(|i| sign * q[i + usize::from(i >= largest)]))
}

/// A format that splats are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Ply,
    Compressed,
    Spz,
    Splat,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let stem = path.file_stem().map(Path::new).map(extension);
        match (extension(path).as_str(), stem.as_deref()) {
            ("ply", Some("compressed")) => Ok(Self::Compressed),
            ("ply", _) => Ok(Self::Ply),
            ("spz", _) => Ok(Self::Spz),
            ("splat", _) => Ok(Self::Splat),
            _ => Err(Error::extension(path, "`.ply`, `.compressed.ply`, `.spz` or `.splat`")),
        }
    }
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

    /// Writes a file in the format of its extension: `.ply`, `.compressed.ply`, `.spz` or `.splat`. The file appears
    /// complete or not at all.
    ///
    /// A `.ply` has all that was read; see [`Splats::write_ply`] for new columns. The others round every number:
    /// positions of a `.compressed.ply` to 1/2047 of the extent of 256 splats, of an `.spz` to 2⁻¹² scene units, finer
    /// if the scene is smaller than 1, coarser if it is larger than 2048. Splats of an `.spz` are written in the
    /// version and with the steps that they were read with. [`Splats::not_kept`] names what has no place.
    ///
    /// # Errors
    /// If the extension is another one, if a coordinate is too large for an `.spz`, or if writing fails.
    pub fn write(&self, path: &Path) -> Result<()> {
        match Format::of(path)? {
            Format::Ply => self.write_ply(path, &[], &[]),
            Format::Compressed => compressed::write(self, path),
            Format::Spz => spz::write(self, path),
            Format::Splat => splat::write(self, path),
        }
    }

    /// Whether the format of a file has a place for new columns, as [`Splats::write_ply`] writes them.
    #[must_use]
    pub fn takes_columns(path: &Path) -> bool {
        Format::of(path).is_ok_and(|format| format == Format::Ply)
    }

    /// What of these splats the format of a file has no place for.
    ///
    /// # Errors
    /// If [`Splats::write`] does not write such files.
    pub fn not_kept(&self, path: &Path) -> Result<Vec<String>> {
        let format = Format::of(path)?;
        let mut lost = Vec::new();
        if format != Format::Ply {
            // Normals are zeros that no program reads.
            lost.extend(
                self.extra_names()
                    .into_iter()
                    .filter(|name| !["nx", "ny", "nz"].contains(name))
                    .map(|name| format!("property `{name}`")),
            );
        }
        if format == Format::Splat && self.degree() > 0 {
            lost.push("colours that depend on the direction".into());
        }
        match (format, self.mode()) {
            (Format::Splat, RenderMode::Mip | RenderMode::MipSplatting) => lost.push(format!("mode `{}`", self.mode())),
            (Format::Spz, RenderMode::MipSplatting) => lost.push("the dilation of Mip-Splatting, 0.1 px²".into()),
            _ => {}
        }
        Ok(lost)
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::super::coefficients;
    use super::*;

    /// Random splats, with numbers in the range of trained ones.
    pub(super) fn random(n: usize, degree: u8) -> Splats {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut in_range = |low: f32, high: f32| rng.random_range(low..high);
        let mut vector = |low: f32, high: f32| Vec3::new(in_range(low, high), in_range(low, high), in_range(low, high));
        let means = (0..n).map(|_| vector(-4.0, 4.0)).collect();
        let scales = (0..n).map(|_| vector(-7.0, 1.0)).collect();
        let axes: Vec<Vec3> = (0..n).map(|_| vector(-1.0, 1.0)).collect();
        let rotations = axes.iter().map(|v| Quat::from_xyzw(v.x, v.y, v.z, in_range(-1.0, 1.0)).normalize()).collect();
        let logits = (0..n).map(|_| in_range(-4.0, 4.0)).collect();
        // Colours within pictures' range, so that none is cut off.
        let sh = (0..n * 3 * coefficients(degree)).map(|_| in_range(-1.0, 1.0)).collect();
        Splats::new(means, scales, rotations, logits, sh, degree, RenderMode::Mip).unwrap()
    }

    #[test]
    fn formats_follow_from_extensions_and_do_not_keep_everything() {
        let folder = tempfile::tempdir().unwrap();
        let splats = random(20, 1);
        let lost = |name: &str| splats.not_kept(Path::new(name)).unwrap();
        assert_eq!([lost("a.ply"), lost("a.compressed.ply"), lost("a.SPZ")], [const { Vec::<String>::new() }; 3]);
        let takes = ["a.ply", "a.compressed.ply", "a.spz", "a.sog"].map(|name| Splats::takes_columns(Path::new(name)));
        assert_eq!(takes, [true, false, false, false]);
        assert_eq!(lost("a.splat"), ["colours that depend on the direction", "mode `mip`"]);
        let path = folder.path().join("columns.ply");
        splats.write_ply(&path, &[("uncertainty", &[1.0; 20])], &[]).unwrap();
        let with_column = Splats::read(&path).unwrap().with_mode(RenderMode::MipSplatting);
        let expected = ["property `uncertainty`", "the dilation of Mip-Splatting, 0.1 px²"];
        assert_eq!(with_column.not_kept(Path::new("a.spz")).unwrap(), expected);
        let error = splats.write(&folder.path().join("a.sog")).unwrap_err().to_string();
        assert!(error.contains("`.ply`, `.compressed.ply`, `.spz` or `.splat`"), "{error}");
        // A `.splat` has positions and scales as they are, and 8 bits of all else.
        let path = folder.path().join("a.splat");
        splats.write(&path).unwrap();
        let again = Splats::read(&path).unwrap();
        assert_eq!(again.means(), splats.means());
        for i in 0..20 {
            assert!((again.log_scales()[i] - splats.log_scales()[i]).abs().max_element() < 1e-5);
            assert!((color_of(again.sh(i)) - color_of(splats.sh(i))).abs().max_element() < 0.5 / 255.0 + 1e-6);
            // Four entries, each off by half of 1/128.
            assert!(again.rotation(i).dot(splats.rotation(i)).abs() > 1.0 - 0.5 * 4.0 * (0.5 / 128.0_f32).powi(2));
            assert!((again.opacity(i) - splats.opacity(i)).abs() < 0.5 / 255.0 + 1e-6);
        }
        for extension in ["compressed.ply", "spz", "ply"] {
            splats.write(&folder.path().join(format!("b.{extension}"))).unwrap();
            assert_eq!(Splats::read(&folder.path().join(format!("b.{extension}"))).unwrap().len(), 20);
        }
    }

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
