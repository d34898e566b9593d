//! Reads a `.ppng` file: one CBOR map with tables, weights, run lengths of the occupancy grid, and poses.
//!
//! No length that the file states is used for an allocation. Byte strings are slices of what is there, and a
//! list grows as its elements arrive.

use std::path::Path;

use glam::{DMat3, DVec3};
use half::f16;
use minicbor::data::Type;
use minicbor::decode::{Decoder, Error as CborError};

use super::features::{Encoding, FEATURES, FREQUENCIES, Kind, SLOTS};
use super::network::Network;
use octobayes::{Error, Result};

/// Largest number of grid points of a table axis; trained files have 80.
const MAX_QUANTS: u64 = 1024;
/// Largest rank; trained files have 8 (type 1) and 2 (type 2).
const MAX_RANK: u64 = 64;
/// Largest number of cascades, as in instant-ngp.
const MAX_CASCADES: u64 = 8;
/// Largest frequency, half turns per unit of the box. Trained files go up to 16. f32 still resolves 1e-4 of a
/// turn at 1024.
const MAX_FREQUENCY: f64 = 1024.0;

/// The checked content of a file.
#[derive(Debug)]
pub struct File {
    /// The tables.
    pub encoding: Encoding,
    /// Type, Q and R.
    pub size: (Kind, usize, usize),
    /// The networks.
    pub network: Network,
    /// Cells per axis of the occupancy grid.
    pub cells: usize,
    /// `[cascades][cells³]`, x fastest.
    pub occupied: Vec<Vec<bool>>,
    /// Camera-to-world rotation (columns right, down, forward) and position, of each training camera.
    pub poses: Vec<(DMat3, DVec3)>,
    /// Distance between samples, file units.
    pub step: f64,
}

/// Values as they come; any may be missing.
#[derive(Default)]
struct Raw<'a> {
    integers: [Option<u64>; INTEGERS.len()],
    bytes: [Option<&'a [u8]>; BYTES.len()],
    freqs: Option<Vec<f64>>,
    runs: Option<Vec<Vec<u32>>>,
    poses: Option<Vec<Vec<Vec<f64>>>>,
    render_step: Option<f64>,
}

/// Keys of integers with their accepted ranges.
const INTEGERS: [(&str, [u64; 2]); 7] = [
    ("n_freqs", [FREQUENCIES as u64; 2]),
    ("n_feats", [FEATURES as u64; 2]),
    ("qff_type", [1, 2]),
    ("n_quants", [2, MAX_QUANTS]),
    ("rank", [1, MAX_RANK]),
    ("grid_res", [4, 128]),
    ("grid_mip", [1, MAX_CASCADES]),
];
/// Keys of byte strings.
const BYTES: [&str; 4] = ["qff_buffer", "qff_density_layer_0", "qff_color_layer_0", "qff_color_layer_1"];

impl File {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &octobayes::io::read(path)?)
    }

    /// Checks the bytes of a file; `path` is for messages only.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        Raw::decode(path, bytes)?.check(path)
    }
}

/// Reads elements until the list ends, into a vector that grows as they arrive.
fn list<'b, T>(
    decoder: &mut Decoder<'b>,
    mut element: impl FnMut(&mut Decoder<'b>) -> std::result::Result<T, CborError>,
) -> std::result::Result<Vec<T>, CborError> {
    let mut elements = Vec::new();
    match decoder.array()? {
        Some(count) => {
            for _ in 0..count {
                elements.push(element(decoder)?);
            }
        }
        None => {
            while decoder.datatype()? != Type::Break {
                elements.push(element(decoder)?);
            }
            decoder.skip()?;
        }
    }
    Ok(elements)
}

/// Reads a number of any width.
fn number(decoder: &mut Decoder) -> std::result::Result<f64, CborError> {
    match decoder.datatype()? {
        Type::F16 | Type::F32 | Type::F64 => decoder.f64(),
        _ => decoder.i64().map(|v| v as f64),
    }
}

impl<'a> Raw<'a> {
    fn decode(path: &Path, bytes: &'a [u8]) -> Result<Self> {
        let mut decoder = Decoder::new(bytes);
        let mut raw = Self::default();
        let wrong = |key: &str, at: usize, error: &CborError| {
            let place = if key.is_empty() { format!("byte {at}") } else { format!("`{key}`, byte {at}") };
            Error::malformed(path, place, "a ppng model, one CBOR map", error.to_string())
        };
        let entries = decoder.map().map_err(|e| wrong("", 0, &e))?;
        let mut seen = 0;
        loop {
            let at = decoder.position();
            let more = match entries {
                Some(entries) => seen < entries,
                None => decoder.datatype().map_err(|e| wrong("", at, &e))? != Type::Break,
            };
            if !more {
                break;
            }
            let key = decoder.str().map_err(|e| wrong("", at, &e))?;
            let at = decoder.position();
            if raw.entry(key, &mut decoder).map_err(|e| wrong(key, at, &e))? {
                return Err(Error::malformed(path, format!("`{key}`, byte {at}"), "every key once", "it again"));
            }
            seen += 1;
        }
        if entries.is_none() {
            decoder.skip().map_err(|e| wrong("", decoder.position(), &e))?;
        }
        match bytes.len() - decoder.position() {
            0 => Ok(raw),
            rest => Err(Error::malformed(
                path,
                format!("byte {}", decoder.position()),
                "the end",
                format!("{rest} more bytes"),
            )),
        }
    }

    /// Takes one value; returns whether there was one before.
    fn entry(&mut self, key: &str, decoder: &mut Decoder<'a>) -> std::result::Result<bool, CborError> {
        if let Some(i) = INTEGERS.iter().position(|(name, _)| *name == key) {
            return Ok(self.integers[i].replace(decoder.u64()?).is_some());
        }
        if let Some(i) = BYTES.iter().position(|name| *name == key) {
            return Ok(self.bytes[i].replace(decoder.bytes()?).is_some());
        }
        Ok(match key {
            "freqs" => self.freqs.replace(list(decoder, number)?).is_some(),
            "grid_rles" => self.runs.replace(list(decoder, |d| list(d, Decoder::u32))?).is_some(),
            "poses" => self.poses.replace(list(decoder, |d| list(d, |d| list(d, number)))?).is_some(),
            "render_step" => self.render_step.replace(number(decoder)?).is_some(),
            _ => {
                decoder.skip()?;
                false
            }
        })
    }

    fn check(&self, path: &Path) -> Result<File> {
        let missing = |key: &str| Error::malformed(path, format!("`{key}`"), "a value", "none");
        let mut integers = [0; INTEGERS.len()];
        for ((value, given), (key, [low, high])) in integers.iter_mut().zip(self.integers).zip(INTEGERS) {
            let given = given.ok_or_else(|| missing(key))?;
            if !(low..=high).contains(&given) {
                let expected = if low == high { low.to_string() } else { format!("{low} to {high}") };
                return Err(Error::malformed(path, format!("`{key}`"), expected, given.to_string()));
            }
            *value = given as usize;
        }
        let [_, _, kind, quants, rank, cells, cascades] = integers;
        if !cells.is_multiple_of(4) {
            return Err(Error::malformed(path, "`grid_res`", "a multiple of 4", cells.to_string()));
        }
        let kind = if kind == 1 { Kind::Vectors } else { Kind::Planes };

        let [tables, layers @ ..] = self.bytes;
        let count = 3 * SLOTS * kind.points(quants) * rank * FEATURES;
        let tables = numbers(path, BYTES[0], tables.ok_or_else(|| missing(BYTES[0]))?, count, |b| {
            f16::from_le_bytes(b).to_f32()
        })?;
        let mut weights = [const { Vec::new() }; 3];
        for (((weights, bytes), key), size) in weights.iter_mut().zip(layers).zip(&BYTES[1..]).zip(Network::SIZES) {
            *weights = numbers(path, key, bytes.ok_or_else(|| missing(key))?, size, f32::from_le_bytes)?;
        }

        let side = (1_u64 << (cascades - 1)) as f64;
        let freqs = self.freqs.as_ref().ok_or_else(|| missing("freqs"))?;
        let accepted = |f: &f64| *f > 0.0 && *f <= MAX_FREQUENCY;
        let freqs = <[f64; FREQUENCIES]>::try_from(freqs.as_slice())
            .ok()
            .filter(|f| f.iter().all(accepted))
            .ok_or_else(|| {
                let expected = format!("{FREQUENCIES} numbers above 0 and up to {MAX_FREQUENCY}");
                Error::malformed(path, "`freqs`", expected, some_of(freqs))
            })?;
        let step = self.render_step.ok_or_else(|| missing("render_step"))?;
        if !(step >= 1e-6 && step <= side) {
            let expected = format!("a length from 1e-6 to the box's side {side}");
            return Err(Error::malformed(path, "`render_step`", expected, step.to_string()));
        }
        let poses = self.poses.as_ref().ok_or_else(|| missing("poses"))?;
        Ok(File {
            encoding: Encoding::new(kind, freqs.map(|f| (f / side) as f32), quants, rank, &tables),
            size: (kind, quants, rank),
            network: Network::new([&weights[0], &weights[1], &weights[2]]),
            cells,
            occupied: occupied(path, self.runs.as_ref().ok_or_else(|| missing("grid_rles"))?, cells, cascades)?,
            poses: poses.iter().enumerate().map(|(i, rows)| pose(path, i, rows)).collect::<Result<_>>()?,
            step,
        })
    }
}

/// The first few numbers of a list, for messages.
fn some_of(values: &[f64]) -> String {
    let shown = &values[..values.len().min(FREQUENCIES)];
    format!("{} numbers, {shown:?}{}", values.len(), if shown.len() < values.len() { " …" } else { "" })
}

/// `count` little-endian numbers of N bytes, finite.
fn numbers<const N: usize>(
    path: &Path,
    key: &str,
    bytes: &[u8],
    count: usize,
    decode: impl Fn([u8; N]) -> f32,
) -> Result<Vec<f32>> {
    if bytes.len() != N * count {
        let expected = format!("{} bytes ({count} numbers of {N})", N * count);
        return Err(Error::malformed(path, format!("`{key}`"), expected, format!("{} bytes", bytes.len())));
    }
    let values: Vec<f32> = bytes.as_chunks::<N>().0.iter().map(|b| decode(*b)).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => {
            Err(Error::malformed(path, format!("`{key}`, element {i}"), "a finite number", values[i].to_string()))
        }
        None => Ok(values),
    }
}

/// Occupied cells of each cascade from run lengths, starting with empty cells.
fn occupied(path: &Path, runs: &[Vec<u32>], cells: usize, cascades: usize) -> Result<Vec<Vec<bool>>> {
    let volume = cells.pow(3);
    if runs.len() != cascades {
        let expected = format!("{cascades} lists, one per cascade (`grid_mip`)");
        return Err(Error::malformed(path, "`grid_rles`", expected, runs.len().to_string()));
    }
    let expand = |(k, runs): (usize, &Vec<u32>)| {
        let sum: u64 = runs.iter().map(|&run| u64::from(run)).sum();
        if sum != volume as u64 {
            let expected = format!("run lengths that sum to {cells}^3 = {volume}");
            return Err(Error::malformed(path, format!("`grid_rles`, cascade {k}"), expected, sum.to_string()));
        }
        let values = runs.iter().enumerate();
        Ok(values.flat_map(|(i, &run)| std::iter::repeat_n(i % 2 == 1, run as usize)).collect())
    };
    runs.iter().enumerate().map(expand).collect()
}

/// Rotation and position of a `[3][4]` pose.
fn pose(path: &Path, index: usize, rows: &[Vec<f64>]) -> Result<(DMat3, DVec3)> {
    let wrong =
        |found: String| Error::malformed(path, format!("`poses`, pose {index}"), "a 3x4 camera-to-world pose", found);
    if rows.len() != 3 || rows.iter().any(|row| row.len() != 4) {
        return Err(wrong(format!("{} rows", rows.len())));
    }
    let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
    let (axes, position) = (DMat3::from_cols(column(0), column(1), column(2)), column(3));
    // Poses are f32 products of rotations; optimised ones drift a little more. NaN fails the comparison.
    let skew = axes.transpose() * axes - DMat3::IDENTITY;
    let is_rotation = skew.to_cols_array().iter().all(|v| v.abs() <= 1e-2) && axes.determinant() > 0.0;
    // A camera farther away sees nothing of a box of at most 128 units. The largest of several numbers need not be NaN
    // if one of them is.
    if is_rotation && position.is_finite() && position.abs().max_element() <= 1e6 {
        Ok((axes, position))
    } else {
        Err(wrong(format!("rows {rows:?}")))
    }
}
