//! Ray samples in a `.npz` file: the interface for Jacobians from any other framework.
//!
//! The arrays are the following. Other types of floats and integers are converted.
//! - `positions`: f32 `[N, 3]`, scene units.
//! - `jacobian`: f32 `[N, 3, 3]` = ∂C_c/∂x_k, colours in rows, axes in columns.
//! - `ray`: u64 `[N]`, non-decreasing ray index.
//! - `rays_total`: integer scalar, the number of rays drawn, including those that hit nothing.
//! - `weight` (optional): f32 `[N]`, the sample's weight in the pixel's colour, which identifies visible
//!   surfaces.
//! - `training_pixels` (optional): integer scalar, the number of pixels of all training images, for the scale of the
//!   data.
//!
//! Reading and writing both stream: neither holds more than a few batches in memory.

use std::fs::File;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};

use glam::Vec3;
use zip::read::ZipFile;

use crate::npy::{ArrayStream, write_header};
use crate::npz::{NpzReader, NpzWriter};
use crate::{Index, Real};
use octobayes::io::AtomicFile;
use octobayes::monitor::{Monitor, check};
use octobayes::rays::Gathered;
use octobayes::render::{RaySample, RaySamples};
use octobayes::{Error, Result};

/// Number of batches passed on together.
const GROUP: usize = 16;

/// Writes samples as they arrive. The archive is assembled at the end, because a zip file stores one member after
/// the other.
pub struct SamplesWriter {
    target: PathBuf,
    /// Raw little-endian data of `positions`, `jacobian`, `ray`, `weight`.
    parts: [AtomicFile; 4],
    samples: u64,
}

impl SamplesWriter {
    /// Starts writing the file `target`.
    ///
    /// # Errors
    /// If the folder is not writable.
    pub fn create(target: &Path) -> Result<Self> {
        let part = || AtomicFile::create(target);
        Ok(Self { target: target.to_path_buf(), parts: [part()?, part()?, part()?, part()?], samples: 0 })
    }

    /// Appends samples.
    ///
    /// # Errors
    /// If the disk is full.
    pub fn add(&mut self, batches: &[RaySamples]) -> Result<()> {
        let [positions, jacobian, ray, weight] = &mut self.parts;
        let mut write = || {
            for batch in batches {
                for x in &batch.positions {
                    x.to_array().iter().try_for_each(|v| positions.write_all(&v.to_le_bytes()))?;
                }
                for j in &batch.jacobians {
                    j.iter().try_for_each(|v| jacobian.write_all(&v.to_le_bytes()))?;
                }
                for w in &batch.weights {
                    weight.write_all(&w.to_le_bytes())?;
                }
                for (index, samples) in batch.iter() {
                    samples.into_iter().try_for_each(|_| ray.write_all(&index.to_le_bytes()))?;
                }
                self.samples += batch.positions.len() as u64;
            }
            Ok(())
        };
        write().map_err(Error::io(&self.target, "cannot write"))
    }

    /// Assembles the archive.
    ///
    /// # Errors
    /// If the disk is full.
    pub fn finish(self, rays_total: u64, training_pixels: u64) -> Result<()> {
        let Self { target, parts, samples: n } = self;
        let mut npz = NpzWriter::create(&target)?;
        let members: [(&str, &[u64]); 4] =
            [("positions", &[n, 3]), ("jacobian", &[n, 3, 3]), ("ray", &[n]), ("weight", &[n])];
        for (part, (name, shape)) in parts.into_iter().zip(members) {
            let failed = || Error::io(&target, "cannot write");
            let (mut data, _removed_at_the_end) = part.into_reader().map_err(failed())?;
            let member = npz.member(name)?;
            let header = if name == "ray" { write_header::<u64> } else { write_header::<f32> };
            header(member, shape).and_then(|()| std::io::copy(&mut data, member)).map_err(failed())?;
        }
        npz.array("rays_total", &[], [rays_total as i64])?;
        npz.array("training_pixels", &[], [training_pixels as i64])?;
        npz.finish()
    }
}

/// Reads samples as a stream.
pub struct SamplesReader {
    path: PathBuf,
    rays_total: u64,
    training_pixels: Option<u64>,
    samples: u64,
    has_weights: bool,
}

impl SamplesReader {
    /// True for an archive of arrays that holds Jacobians.
    #[must_use]
    pub fn is_samples(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension == "npz")
            && NpzReader::open(path).is_ok_and(|npz| npz.has("jacobian"))
    }

    /// Opens a file and checks the shapes and types of its arrays.
    ///
    /// # Errors
    /// If an array is missing or differs from the module's documentation.
    pub fn open(path: &Path) -> Result<Self> {
        let mut npz = NpzReader::open(path)?;
        let positions = npz.stream::<Real>("positions")?;
        positions.expect_shape(&[None, Some(3)])?;
        let samples = positions.shape()[0];
        drop(positions);
        npz.stream::<Real>("jacobian")?.expect_shape(&[Some(samples), Some(3), Some(3)])?;
        npz.stream::<Index>("ray")?.expect_shape(&[Some(samples)])?;
        let has_weights = npz.has("weight");
        if has_weights {
            npz.stream::<Real>("weight")?.expect_shape(&[Some(samples)])?;
        }
        let rays_total = read_count(&mut npz, "rays_total", path)?;
        let training_pixels =
            npz.has("training_pixels").then(|| read_count(&mut npz, "training_pixels", path)).transpose()?;
        Ok(Self { path: path.to_path_buf(), rays_total, training_pixels, samples, has_weights })
    }

    /// Number of rays drawn, including those that hit nothing.
    #[must_use]
    pub fn rays_total(&self) -> u64 {
        self.rays_total
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of pixels of all training images, if the file states it.
    #[must_use]
    pub fn training_pixels(&self) -> Option<u64> {
        self.training_pixels
    }

    /// Number of samples in the file.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Passes all samples to `sink`, in order, a few thousand rays at a time.
    ///
    /// # Errors
    /// If `sink` fails, a value is not finite, ray indices decrease or reach `rays_total`, a ray has more than 65,536
    /// samples, the file is truncated, or a checksum of the archive does not match its content.
    pub fn run(&self, monitor: &dyn Monitor, mut sink: impl FnMut(&[RaySamples]) -> Result<()>) -> Result<()> {
        let open = || NpzReader::open(&self.path);
        let (mut a, mut b, mut c, mut d) = (open()?, open()?, open()?, open()?);
        let mut positions = a.stream::<Real>("positions")?;
        let mut jacobians = b.stream::<Real>("jacobian")?;
        let mut rays = c.stream::<Index>("ray")?;
        let mut weights = if self.has_weights { Some(d.stream::<Real>("weight")?) } else { None };

        monitor.begin("samples", self.samples);
        let mut gathered = Gathered::new(self.rays_total);
        for sample in 0..self.samples {
            let Index(ray) = self.present(rays.next_element()?, "ray", sample)?;
            let position = Vec3::from_array(self.floats(&mut positions, sample)?);
            let jacobian = self.floats(&mut jacobians, sample)?;
            let weight = match &mut weights {
                Some(weights) => self.floats::<1>(weights, sample)?[0],
                None => 0.0,
            };
            let pushed = gathered.push(ray, RaySample { position, jacobian, weight });
            let complete = pushed.map_err(|(expected, found)| {
                Error::malformed(&self.path, format!("array `ray`, element {sample}"), expected, found)
            })?;
            let Some(samples) = complete else { continue };
            monitor.advance(samples as u64);
            if let Some(batches) = gathered.take(GROUP) {
                check(monitor)?;
                sink(&batches)?;
            }
        }
        // Reading past the last element verifies the archive's checksums.
        rays.next_element()?;
        positions.next_element()?;
        jacobians.next_element()?;
        weights.iter_mut().try_for_each(|stream| stream.next_element().map(drop))?;
        sink(&gathered.finish())?;
        monitor.end();
        Ok(())
    }

    /// Reads the next `N` numbers of an array, which must be finite.
    fn floats<const N: usize>(
        &self,
        stream: &mut ArrayStream<Real, ZipFile<'_, BufReader<File>>>,
        sample: u64,
    ) -> Result<[f32; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            let next = stream.next_element()?;
            Real(*value) = self.present(next, stream.origin().1, sample)?;
            if !value.is_finite() {
                let place = format!("array `{}`, sample {sample}", stream.origin().1);
                return Err(Error::malformed(&self.path, place, "finite numbers", value.to_string()));
            }
        }
        Ok(values)
    }

    fn present<T>(&self, value: Option<T>, name: &str, sample: u64) -> Result<T> {
        value.ok_or_else(|| {
            let expected = format!("{} samples", self.samples);
            Error::malformed(&self.path, format!("array `{name}`"), expected, format!("{sample}"))
        })
    }
}

/// Reads one number in any of NumPy's usual integer types, as a scalar or an array of one element.
fn read_count(npz: &mut NpzReader, name: &str, path: &Path) -> Result<u64> {
    let place = || format!("array `{name}`");
    let mut stream = npz.stream::<Index>(name)?;
    // One number, whatever else the array claims to hold.
    let found = stream.shape().iter().product::<u64>();
    if found > 1 {
        return Err(Error::malformed(path, place(), "one integer above 0", format!("{found} of them")));
    }
    let value = stream.next_element()?.map(|Index(value)| value);
    // Reading past it verifies the archive's checksum.
    stream.next_element()?;
    value.filter(|&v| v > 0).ok_or_else(|| Error::malformed(path, place(), "one integer above 0", "none or less"))
}
