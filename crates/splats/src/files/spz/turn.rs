//! From the axes of a `.spz` file to those of PLY files.

use std::path::Path;

use glam::{Vec3, Vec4};

use octobayes::{Error, Result};

/// The axes of files that state none: right, up, back.
pub(super) const STORED: u32 = 4;
/// Right, down, front.
const PLY: u32 = 6;
/// The axes that differ from each other by signs alone, in the order of the format's numbers from 1.
const AXES: [&str; 8] = ["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"];

/// Longest list of extensions, bytes. Those that are known have 4 and 12 bytes.
pub(super) const MOST_EXTENSIONS: u64 = 1 << 16;
/// Extension of Adobe: how far a viewer's camera may go. It changes nothing.
const SAFE_ORBIT: u32 = 0xadbe_0002;
/// Extension of Adobe: the axes that the file's numbers are in.
const COORDINATES: u32 = 0xadbe_0003;

/// Axes in which each spherical harmonic is odd: bit 0 for x, 1 for y, 2 for z.
const ODD: [u8; 16] =
    [0, 0b010, 0b100, 0b001, 0b011, 0b110, 0, 0b101, 0, 0b010, 0b111, 0b010, 0b100, 0b001, 0b100, 0b001];

/// Signs of the axes.
pub(super) struct Turn([f32; 3]);

impl Turn {
    /// The signs that turn one of [`AXES`], by number from 1, to those of PLY files.
    pub fn from(stored: u32) -> Self {
        // The three bits of a number are those of right, up and front.
        let differs = (stored - 1) ^ (PLY - 1);
        Self([0, 1, 2].map(|axis: u32| if differs >> axis & 1 == 1 { -1.0 } else { 1.0 }))
    }

    pub fn position(&self, x: Vec3) -> Vec3 {
        x * Vec3::from_array(self.0)
    }

    /// A rotation (x, y, z, w) about a turned axis: mirroring two of its coordinates turns the axis and its sense.
    pub fn rotation(&self, q: Vec4) -> Vec4 {
        let [x, y, z] = self.0;
        q * Vec4::new(y * z, x * z, x * y, 1.0)
    }

    /// The sign of a coefficient of the spherical harmonic of this number.
    pub fn sh(&self, number: usize) -> f32 {
        let odd = ODD[number];
        (0..3).filter(|axis| odd >> axis & 1 == 1).map(|axis| self.0[axis]).product()
    }
}

/// The axes that the extensions of a file state, by number: records of type, length and content.
///
/// # Errors
/// If an extension is unknown, for it could change what the numbers mean, or if axes are not of [`AXES`].
pub(super) fn stored_axes(path: &Path, mut records: &[u8]) -> Result<u32> {
    let wrong = |expected: &str, found: String| Err(Error::malformed(path, "extensions", expected, found));
    if records.len() as u64 > MOST_EXTENSIONS {
        return wrong("at most 65536 bytes", "more".into());
    }
    let mut axes = STORED;
    while !records.is_empty() {
        let word = |at: usize| records.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let (Some(kind), Some(length)) = (word(0), word(4)) else {
            return wrong("records of type, length and content", format!("{} bytes left", records.len()));
        };
        let Some(content) = records[8..].get(..length as usize) else {
            return wrong(&format!("at most {} bytes of content", records.len() - 8), length.to_string());
        };
        match kind {
            SAFE_ORBIT => {}
            COORDINATES => {
                let stated = if content.len() == 4 { word(8) } else { None };
                axes = match stated {
                    Some(0) => STORED,
                    Some(number) if number as usize <= AXES.len() => number,
                    _ => {
                        let found = stated.map_or(format!("{} bytes", content.len()), |number| number.to_string());
                        return wrong(&format!("axes 1 to 8 ({})", AXES.join(", ")), found);
                    }
                };
            }
            _ => {
                let expected = "those of a safe orbit camera or of axes (0xadbe0002, 0xadbe0003): another may change \
                                what the numbers mean; `splat-transform` (npm) writes the file without";
                return wrong(expected, format!("{kind:#010x}"));
            }
        }
        records = &records[8 + content.len()..];
    }
    Ok(axes)
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Quat};

    use super::*;

    /// The polynomials of the spherical harmonics, without their factors.
    fn harmonics(d: Vec3) -> [f32; 16] {
        let (x, y, z, zz) = (d.x, d.y, d.z, d.z * d.z);
        let square = x * x - y * y;
        let third = [y * (3.0 * x * x - y * y), x * y * z, y * (5.0 * zz - 1.0), z * (5.0 * zz - 3.0)];
        let last = [x * (5.0 * zz - 1.0), z * square, x * (x * x - 3.0 * y * y)];
        let first = [1.0, y, z, x, x * y, y * z, 3.0 * zz - 1.0, x * z, square];
        let mut all = [0.0; 16];
        all.iter_mut().zip(first.into_iter().chain(third).chain(last)).for_each(|(all, value)| *all = value);
        all
    }

    #[test]
    fn turned_splats_are_the_same_seen_from_turned_directions() {
        for stored in 1..=8 {
            let turn = Turn::from(stored);
            let mirror = Mat3::from_diagonal(Vec3::from_array(turn.0));
            let direction = Vec3::new(0.36, -0.48, 0.8);
            let turned = turn.position(direction);
            assert_eq!(turned, mirror * direction);
            let [plain, mirrored] = [direction, turned].map(harmonics);
            for (k, (a, b)) in plain.iter().zip(mirrored).enumerate() {
                assert!((a - turn.sh(k) * b).abs() < 1e-6, "{stored}: harmonic {k}");
            }
            // The covariance R diag(s²) Rᵀ, mirrored.
            let q = Quat::from_xyzw(0.1, -0.5, 0.7, 0.5).normalize();
            let covariance = |q: Quat| {
                let r = Mat3::from_quat(q);
                r * Mat3::from_diagonal(Vec3::new(1.0, 4.0, 9.0)) * r.transpose()
            };
            let expected = mirror * covariance(q) * mirror;
            let found = covariance(Quat::from_vec4(turn.rotation(Vec4::from(q))));
            assert!(found.abs_diff_eq(expected, 1e-5), "{stored}: {found} {expected}");
        }
        assert_eq!((Turn::from(STORED).0, Turn::from(PLY).0), ([1.0, -1.0, -1.0], [1.0; 3]));
    }

    #[test]
    fn extensions_state_axes_or_are_refused() {
        let record = |kind: u32, content: &[u8]| {
            [&kind.to_le_bytes()[..], &(content.len() as u32).to_le_bytes(), content].concat()
        };
        let read = |records: &[u8]| stored_axes(Path::new("s.spz"), records);
        let orbit = record(SAFE_ORBIT, &[0; 12]);
        assert_eq!(read(&[]).unwrap(), STORED);
        assert_eq!(read(&[orbit.clone(), record(COORDINATES, &[6, 0, 0, 0])].concat()).unwrap(), 6);
        assert_eq!(read(&record(COORDINATES, &[0; 4])).unwrap(), STORED);
        for (records, expected) in [
            (record(COORDINATES, &[9, 0, 0, 0]), "axes 1 to 8 (LDB, RDB, LUB, RUB, LDF, RDF, LUF, RUF), found 9"),
            (record(COORDINATES, &[1]), "found 1 bytes"),
            (record(7, &[]), "found 0x00000007"),
            (orbit[..12].to_vec(), "at most 4 bytes of content, found 12"),
            (vec![0; 5], "5 bytes left"),
            (vec![0; 70_000], "at most 65536 bytes, found more"),
        ] {
            let error = read(&records).unwrap_err().to_string();
            assert!(error.starts_with("s.spz: extensions: expected") && error.contains(expected), "{error}");
        }
    }
}
