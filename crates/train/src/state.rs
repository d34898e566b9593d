//! The state of a training run in a file, from which it can be resumed bit for bit.
//!
//! It is a [container] with the sections `table`, its `means` and `squares` (f32 [entries, 4] each), `network`
//! (weights, means and squares in turn) and `occupancy` (f32). A run resumes only from a state whose
//! description equals its own.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::batch::GROUP;
use super::occupancy::OccupancyGrid;
use super::trainer::MAX_RAYS;
use super::{StateFile, Trainer};
use octobayes::io::container;
use octobayes::io::container::{Format, Reader};
use octobayes::{Error, Result};
use octobayes_models::hash_grid::{Entry, Network};

const FORMAT: Format = (b"OCTOTRN\n", 1);

#[derive(Serialize, Deserialize)]
struct Header {
    /// Description that a resumed run must share.
    key: String,
    steps: u64,
    rays: u64,
    rays_per_step: u64,
    /// Time of training so far, in seconds.
    elapsed: f64,
}

impl StateFile {
    /// Checks that the file is the state of a run, whatever run it is.
    ///
    /// # Errors
    /// If it is missing, damaged or another file.
    pub fn check(&self) -> Result<()> {
        Reader::open::<Header>(&self.path, FORMAT).map(|_| ())
    }
}

impl Trainer<'_> {
    /// Saves the run under a description; `elapsed` is its time so far in seconds.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path, key: &str, elapsed: f64) -> Result<()> {
        let header =
            Header { key: key.into(), steps: self.steps, rays: self.rays, rays_per_step: self.rays_per_step, elapsed };
        let networks = [&self.parameters.network, &*self.network_moments.mean, &*self.network_moments.square];
        let network: Vec<f32> = networks.iter().flat_map(|n| n.layers().concat()).collect();
        container::write(
            path,
            FORMAT,
            &header,
            &[
                ("table", &self.parameters.encoding.table.as_slice()),
                ("means", &self.table_moments.mean.as_slice()),
                ("squares", &self.table_moments.square.as_slice()),
                ("network", &network.as_slice()),
                ("occupancy", &self.occupancy.densities.as_slice()),
            ],
        )
    }

    /// Resumes a saved run with the same description; returns its time so far in seconds.
    ///
    /// # Errors
    /// If the file is missing or damaged, or belongs to a run with another description.
    pub fn restore(&mut self, path: &Path, key: &str) -> Result<f64> {
        let (header, mut file) = Reader::open::<Header>(path, FORMAT)?;
        if header.key != key {
            let expected = format!("a run with the same settings and data, {key}");
            let found = format!("another, which a restart discards, {}", header.key);
            return Err(Error::malformed(path, "run", expected, found));
        }
        let entries = self.parameters.encoding.table.len();
        let mut tables = [const { Vec::<Entry>::new() }; 3];
        for (table, name) in tables.iter_mut().zip(["table", "means", "squares"]) {
            *table = file.section(name)?;
        }
        let network = file.section::<f32>("network")?;
        let densities = file.section::<f32>("occupancy")?;
        let weights = Network::zero().layers().iter().map(|layer| layer.len()).sum::<usize>();
        let lengths = [tables[0].len(), tables[1].len(), tables[2].len(), network.len(), densities.len()];
        let expected = [entries, entries, entries, 3 * weights, self.occupancy.densities.len()];
        let finite = tables.iter().flatten().flatten().chain(&network).all(|v| v.is_finite())
            && densities.iter().all(|d| !d.is_nan())
            && (header.elapsed >= 0.0 && header.elapsed.is_finite());
        let possible = (GROUP..=MAX_RAYS).contains(&header.rays_per_step) && header.rays_per_step.is_multiple_of(GROUP);
        if lengths != expected || !finite || !possible {
            let found =
                format!("{lengths:?} numbers, {} rays per step, or some that are not finite", header.rays_per_step);
            return Err(Error::malformed(path, "sections", format!("{expected:?} finite numbers"), found));
        }
        let [table, mean, square] = tables;
        self.parameters.encoding.table = table;
        self.table_moments.mean = mean;
        self.table_moments.square = square;
        let networks =
            [&mut self.parameters.network, &mut self.network_moments.mean, &mut *self.network_moments.square];
        let mut rest = network.as_slice();
        for network in networks {
            for layer in network.layers_mut() {
                let (own, others) = rest.split_at(layer.len());
                layer.copy_from_slice(own);
                rest = others;
            }
        }
        self.occupancy = OccupancyGrid::restore(self.settings.config.occupancy, &self.space, densities);
        (self.steps, self.rays, self.rays_per_step) = (header.steps, header.rays, header.rays_per_step);
        Ok(header.elapsed)
    }
}
