//! The file of a trained hash grid: safetensors with one metadata entry that describes it.
//!
//! ```text
//! metadata octobayes_hash_grid: {"version", "config", "domain", "training", "cameras"}, JSON;
//!          older files have no cameras
//! encoding.0 … encoding.7       f32 [entries, 4]
//! network.density0 …            f32 [in, out]
//! occupancy                     u8 [n³ / 8], bit i & 7 of byte i >> 3 for cell i, x fastest
//! ```

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use super::config::{HashGridConfig, N_FEATURES_PER_LEVEL, N_GEOMETRY, N_LEVELS, N_NEURONS};
use super::encoding::Encoding;
use super::network::{LAYERS, Network};
use super::{HashGrid, Parameters, Space};
use octobayes::geometry::{Domain, NamedCamera};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// The only metadata entry. The format does not order entries, and the same model should give the same bytes.
const KEY: &str = "octobayes_hash_grid";
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    config: Config,
    domain: Domain,
    training: serde_json::Value,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    cameras: Vec<NamedCamera>,
}

/// The configurable part, and what is compiled in.
#[derive(Serialize, Deserialize)]
struct Config {
    n_levels: usize,
    n_features_per_level: usize,
    n_neurons: usize,
    n_geometry: usize,
    #[serde(flatten)]
    chosen: HashGridConfig,
}

/// Little-endian bytes of f32 numbers.
fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

impl HashGrid {
    /// Checks whether a safetensors file holds a hash grid. Damaged files give `false` too.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn is_in(path: &Path) -> Result<bool> {
        let content = octobayes::io::read(path)?;
        let metadata = SafeTensors::read_metadata(&content).ok().and_then(|(_, header)| header.metadata().clone());
        Ok(metadata.is_some_and(|entries| entries.contains_key(KEY)))
    }

    /// Writes the field. The file appears complete or not at all, and the same field gives the same bytes.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let header = Header {
            version: VERSION,
            config: Config {
                n_levels: N_LEVELS,
                n_features_per_level: N_FEATURES_PER_LEVEL,
                n_neurons: N_NEURONS,
                n_geometry: N_GEOMETRY,
                chosen: self.config,
            },
            domain: self.space.domain,
            training: self.training.clone(),
            cameras: self.cameras.clone(),
        };
        let failed = |e: &dyn std::fmt::Display| Error::malformed(path, "header", "an encodable model", e.to_string());
        let text = serde_json::to_string(&header).map_err(|e| failed(&e))?;

        let mut tensors = Vec::new();
        let mut first = 0;
        for (l, level) in self.parameters.encoding.levels().iter().enumerate() {
            let entries = &self.parameters.encoding.table[first..first + level.size];
            let shape = vec![level.size, N_FEATURES_PER_LEVEL];
            tensors.push((format!("encoding.{l}"), Dtype::F32, shape, bytes(entries.as_flattened())));
            first += level.size;
        }
        for ((name, shape), weights) in LAYERS.iter().zip(self.parameters.network.layers()) {
            tensors.push((format!("network.{name}"), Dtype::F32, shape.to_vec(), bytes(weights)));
        }
        let bits = |cells: &[bool; 8]| cells.iter().rev().fold(0_u8, |byte, &cell| byte << 1 | u8::from(cell));
        let packed: Vec<u8> = self.occupied.as_chunks::<8>().0.iter().map(bits).collect();
        tensors.push(("occupancy".into(), Dtype::U8, vec![packed.len()], packed));

        let views = tensors.iter().map(|(name, dtype, shape, data)| {
            TensorView::new(*dtype, shape.clone(), data).map(|view| (name.as_str(), view))
        });
        let views = views.collect::<std::result::Result<Vec<_>, _>>().map_err(|e| failed(&e))?;
        let content =
            safetensors::serialize(views, Some(HashMap::from([(KEY.into(), text)]))).map_err(|e| failed(&e))?;
        let mut file = AtomicFile::create(path)?;
        file.write_all(&content).map_err(Error::io(path, "cannot write"))?;
        file.commit()
    }

    /// Reads a field that [`HashGrid::write`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read, is damaged, has another version or architecture, or a weight is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let content = octobayes::io::read(path)?;
        let damaged =
            |e: safetensors::SafeTensorError| Error::malformed(path, "header", "a safetensors file", e.to_string());
        let (_, metadata) = SafeTensors::read_metadata(&content).map_err(damaged)?;
        let tensors = SafeTensors::deserialize(&content).map_err(damaged)?;
        let place = format!("metadata `{KEY}`");
        let text = metadata.metadata().as_ref().and_then(|entries| entries.get(KEY));
        let text = text.ok_or_else(|| Error::malformed(path, &place, "the description of a hash grid", "none"))?;
        let header: Header = serde_json::from_str(text)
            .map_err(|e| Error::malformed(path, &place, "the description of a hash grid", e.to_string()))?;
        if header.version != VERSION {
            let found = format!("{}; a newer octobayes may read it", header.version);
            return Err(Error::malformed(path, place, format!("version {VERSION}"), found));
        }
        let config = header.config;
        let [expected, found] = [
            [N_LEVELS, N_FEATURES_PER_LEVEL, N_NEURONS, N_GEOMETRY],
            [config.n_levels, config.n_features_per_level, config.n_neurons, config.n_geometry],
        ]
        .map(|[l, f, n, g]| format!("{l} levels of {f} features, {n} neurons, {g} geometry features"));
        if expected != found {
            return Err(Error::malformed(path, place, expected, found));
        }
        let wrong = |e: Error| Error::malformed(path, &place, "a possible model", e.to_string());
        let config = config.chosen.checked().map_err(wrong)?;
        let space = Space::new(header.domain).map_err(wrong)?;

        // Every allocation has the size of a tensor that is really there.
        let mut table = Vec::new();
        for (l, level) in Encoding::levels_of(&config).iter().enumerate() {
            let values = floats(path, &tensors, &format!("encoding.{l}"), &[level.size, N_FEATURES_PER_LEVEL])?;
            table.extend_from_slice(values.as_chunks::<N_FEATURES_PER_LEVEL>().0);
        }
        let mut network = Network::zero();
        for ((name, shape), layer) in LAYERS.iter().zip(network.layers_mut()) {
            layer.copy_from_slice(&floats(path, &tensors, &format!("network.{name}"), shape)?);
        }
        let packed = data(path, &tensors, "occupancy", Dtype::U8, &[config.occupancy.pow(3) / 8])?;
        let occupied = packed.iter().flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1 == 1)).collect();
        let parameters = Parameters { encoding: Encoding::new(&config, table), network };
        Ok(Self::new(config, space, parameters, occupied, header.training).with_training_cameras(header.cameras))
    }
}

/// The bytes of a tensor of the expected type and shape.
fn data<'a>(path: &Path, tensors: &SafeTensors<'a>, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&'a [u8]> {
    let place = || format!("tensor `{name}`");
    let expected = format!("{dtype:?} {shape:?}");
    let view = tensors.tensor(name).map_err(|_| Error::malformed(path, place(), &expected, "no such tensor"))?;
    if view.dtype() != dtype || view.shape() != shape {
        return Err(Error::malformed(path, place(), expected, format!("{:?} {:?}", view.dtype(), view.shape())));
    }
    Ok(view.data())
}

/// The numbers of a tensor, all finite.
fn floats(path: &Path, tensors: &SafeTensors, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
    let bytes = data(path, tensors, name, Dtype::F32, shape)?;
    let values: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => {
            let found = values[i].to_string();
            Err(Error::malformed(path, format!("tensor `{name}`, element {i}"), "a finite number", found))
        }
        None => Ok(values),
    }
}
