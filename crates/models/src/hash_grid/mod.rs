//! A trainable field in f32: a multiresolution hash grid, two tiny networks, and spherical harmonics of the direction.
//!
//! The design is that of instant-ngp (Müller et al., SIGGRAPH 2022). The crate `octobayes-train` fits it to images.
//!
//! Letters: `x` scene position, `u` = Φ(x) in the unit cube of the [`Domain`], w window of the occupancy grid.
//!
//! ```text
//! x -> u -> hash grid -> 32 features -> density network -> σ = w exp(g₀) / longest edge, color network -> colour
//! ```
//! Positions go through in blocks, in code that the compiler turns into vector instructions. AVX2 and FMA are
//! used where the processor has them; results do not depend on that.

mod config;
mod derivative;
mod encoding;
mod file;
mod network;
mod space;

pub use config::{HashGridConfig, N_FEATURES_PER_LEVEL, N_GEOMETRY, N_LEVELS, N_NEURONS};
pub use encoding::{Encoding, Entry, WIDTH};
pub use network::{Backward, Forward, LAYERS, N_COLOR, N_VIEW, Network, Transposed, density_derivative};
pub use space::Space;

use glam::Vec3;
use multiversion::multiversion;

use crate::window::Window;
use octobayes::field::harmonics::spherical_harmonics;
use octobayes::field::{Differentiable, Intrinsics, Radiance, RadianceField, TrainedField};
use octobayes::geometry::{Aabb, Camera, Domain, NamedCamera, Norm};
use octobayes::{Error, Result};

/// Number of points that go through all layers together. The buffers of a block take 35 KB.
pub const BLOCK: usize = 64;

/// The parameters that training changes.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    pub encoding: Encoding,
    pub network: Network,
}

/// Fills features, activations of the density network and densities at unit positions `u`, all `[n]`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn density_pass(
    parameters: &Parameters,
    u: &[[f32; 3]],
    f: &mut [[f32; WIDTH]],
    a: &mut [[f32; N_NEURONS]],
    g: &mut [[f32; N_GEOMETRY]],
    sigma: &mut [f32],
) {
    // Block by block, so that activations are still in near caches when the next layer needs them.
    for start in (0..u.len()).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(u.len());
        parameters.encoding.encode(&u[block.clone()], &mut f[block.clone()]);
        let g = &mut g[block.clone()];
        parameters.network.density(&f[block.clone()], &mut a[block.clone()], g);
        for (sigma, g) in sigma[block].iter_mut().zip(g) {
            *sigma = network::density(g[0]);
        }
    }
}

/// Fills the contribution of directions with harmonics `sh` to the colour network's hidden layer.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn view_pass(network: &Network, sh: &[[f32; N_VIEW]], v: &mut [[f32; N_NEURONS]]) {
    network.view(sh, v);
}

/// Fills colours. `b` holds the result of [`view_pass`] before and the hidden layer after.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn color_pass(
    network: &Network,
    g: &[[f32; N_GEOMETRY]],
    b: &mut [[f32; N_NEURONS]],
    color: &mut [[f32; N_COLOR]],
) {
    network.color(g, b, color);
}

/// Backpropagates through both networks, and adds the derivatives by the weights to `weights` if given.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn backward_pass(transposed: &Transposed, forward: Forward, back: &mut Backward, weights: Option<&mut Network>) {
    transposed.backpropagate(forward, back);
    if let Some(weights) = weights {
        weights.add_gradient(forward, back);
    }
}

/// Adds to `weights` the derivatives by the directions' layer, for rays with harmonics `sh`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn view_gradient_pass(weights: &mut Network, sh: &[[f32; N_VIEW]], d_v: &[[f32; N_NEURONS]]) {
    weights.add_view_gradient(sh, d_v);
}

/// Spherical harmonics of a unit direction.
#[must_use]
pub fn harmonics(direction: Vec3) -> [f32; N_VIEW] {
    spherical_harmonics(direction.x, direction.y, direction.z)
}

/// Buffers of one block of points.
struct Buffers {
    u: [[f32; 3]; BLOCK],
    f: [[f32; WIDTH]; BLOCK],
    a: [[f32; N_NEURONS]; BLOCK],
    g: [[f32; N_GEOMETRY]; BLOCK],
    sigma: [f32; BLOCK],
    sh: [[f32; N_VIEW]; BLOCK],
    b: [[f32; N_NEURONS]; BLOCK],
    color: [[f32; N_COLOR]; BLOCK],
}

impl Buffers {
    fn new() -> Box<Self> {
        Box::new(Self {
            u: [[0.0; 3]; BLOCK],
            f: [[0.0; WIDTH]; BLOCK],
            a: [[0.0; N_NEURONS]; BLOCK],
            g: [[0.0; N_GEOMETRY]; BLOCK],
            sigma: [0.0; BLOCK],
            sh: [[0.0; N_VIEW]; BLOCK],
            b: [[0.0; N_NEURONS]; BLOCK],
            color: [[0.0; N_COLOR]; BLOCK],
        })
    }

    fn density(&mut self, parameters: &Parameters, n: usize) {
        let (f, a) = (&mut self.f[..n], &mut self.a[..n]);
        density_pass(parameters, &self.u[..n], f, a, &mut self.g[..n], &mut self.sigma[..n]);
    }

    fn color(&mut self, network: &Network, directions: &[Vec3]) {
        let n = directions.len();
        for (sh, &d) in self.sh.iter_mut().zip(directions) {
            *sh = harmonics(d);
        }
        view_pass(network, &self.sh[..n], &mut self.b[..n]);
        color_pass(network, &self.g[..n], &mut self.b[..n], &mut self.color[..n]);
    }
}

/// A trained hash grid.
///
/// The density is the network's times a continuous window: 1 in occupied cells, 0 from one cell beyond them
/// (in the unit cube). Training sampled occupied cells only. Colour has no window.
#[derive(Debug, Clone)]
pub struct HashGrid {
    config: HashGridConfig,
    space: Space,
    parameters: Parameters,
    /// Occupied cells, `[n³]`, x fastest.
    occupied: Vec<bool>,
    window: Window,
    /// What the field was trained on and how, as JSON.
    training: serde_json::Value,
    /// The training cameras; empty if they are not known.
    cameras: Vec<NamedCamera>,
}

impl HashGrid {
    /// A field of these parts, as trained.
    #[doc(hidden)]
    #[must_use]
    pub fn new(
        config: HashGridConfig,
        space: Space,
        parameters: Parameters,
        occupied: Vec<bool>,
        training: serde_json::Value,
    ) -> Self {
        let window = Window::new(config.occupancy, vec![occupied.clone()]);
        Self { config, space, parameters, occupied, window, training, cameras: Vec::new() }
    }

    /// The same field with known training cameras.
    #[must_use]
    pub fn with_training_cameras(self, cameras: Vec<NamedCamera>) -> Self {
        Self { cameras, ..self }
    }

    /// Hyper-parameters.
    #[must_use]
    pub fn config(&self) -> &HashGridConfig {
        &self.config
    }

    /// The space that the field covers.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.space.domain
    }

    /// The space with its bounds.
    #[doc(hidden)]
    #[must_use]
    pub fn space(&self) -> &Space {
        &self.space
    }

    /// Features and weights.
    #[doc(hidden)]
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The window at a position in the unit cube.
    #[doc(hidden)]
    #[must_use]
    pub fn window_at(&self, u: [f32; 3]) -> f32 {
        self.window.at(Vec3::from_array(u) - 0.5)
    }

    /// Occupied cells of the occupancy grid, `[n³]`, x fastest.
    #[doc(hidden)]
    #[must_use]
    pub fn occupied(&self) -> &[bool] {
        &self.occupied
    }

    /// Cells per axis of the finest occupancy grid that divides the cells of this one.
    #[must_use]
    pub fn finest_occupancy(&self) -> usize {
        self.config.occupancy * (config::MAX_OCCUPANCY / self.config.occupancy)
    }

    /// What is left without some cells of the [finest occupancy grid](Self::finest_occupancy), `[n³]`, x fastest.
    ///
    /// The window falls to 0 over the cells beside those that stay: half as far as before, if the grid has twice the
    /// cells. So a layer of one cell between cells that stay stays, too.
    ///
    /// # Panics
    /// If `removed` is of another size.
    #[must_use]
    pub fn without(&self, removed: &[bool]) -> Self {
        let (n, coarse) = (self.finest_occupancy(), self.config.occupancy);
        assert_eq!(removed.len(), n.pow(3), "a value for every cell of {n} x {n} x {n}");
        if !removed.contains(&true) {
            return self.clone();
        }
        let parent = |cell: usize| {
            let [x, y, z] = [cell % n, cell / n % n, cell / (n * n)].map(|i| i / (n / coarse));
            (z * coarse + y) * coarse + x
        };
        let occupied = (0..n.pow(3)).map(|cell| !removed[cell] && self.occupied[parent(cell)]).collect();
        let config = HashGridConfig { occupancy: n, ..self.config };
        Self::new(config, self.space, self.parameters.clone(), occupied, self.training.clone())
            .with_training_cameras(self.cameras.clone())
    }

    /// The same field with another record of its training.
    #[must_use]
    pub fn with_training(self, training: serde_json::Value) -> Self {
        Self { training, ..self }
    }

    /// What the field was trained on and how, as `octobayes train` wrote it.
    #[must_use]
    pub fn training(&self) -> &serde_json::Value {
        &self.training
    }

    /// The window at u (0 outside the bounds) and u.
    fn place(&self, x: Vec3) -> (f32, [f32; 3]) {
        // Outside, the density is zero and the colour does not matter: that of the centre will do.
        self.space.unit(x).map_or((0.0, [0.5; 3]), |u| (self.window_at(u), u))
    }

    /// Radiance of point `p` of a block, after its passes.
    fn radiance(&self, buffers: &Buffers, window: f32, p: usize) -> Radiance {
        let [r, g, b, _] = buffers.color[p];
        Radiance { density: self.density_scale() * window * buffers.sigma[p], color: Vec3::new(r, g, b) }
    }

    fn density_scale(&self) -> f32 {
        (1.0 / self.space.unit_length()) as f32
    }
}

impl RadianceField for HashGrid {
    fn bounds(&self) -> Aabb {
        self.space.bounds
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let mut buffers = Buffers::new();
        let mut windows = [0.0; BLOCK];
        for ((positions, directions), out) in
            positions.chunks(BLOCK).zip(directions.chunks(BLOCK)).zip(out.chunks_mut(BLOCK))
        {
            let n = positions.len();
            for (p, &x) in positions.iter().enumerate() {
                (windows[p], buffers.u[p]) = self.place(x);
            }
            buffers.density(&self.parameters, n);
            buffers.color(&self.parameters.network, directions);
            for (p, out) in out.iter_mut().enumerate() {
                *out = self.radiance(&buffers, windows[p], p);
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let mut buffers = Buffers::new();
        // Points in empty space need no network. The others are gathered into full blocks.
        let (mut owners, mut windows, mut count) = ([0; BLOCK], [0.0; BLOCK], 0);
        let flush = |buffers: &mut Buffers, owners: &[usize], windows: &[f32], out: &mut [f32]| {
            buffers.density(&self.parameters, owners.len());
            for ((&owner, &window), &sigma) in owners.iter().zip(windows).zip(&buffers.sigma) {
                out[owner] = self.density_scale() * window * sigma;
            }
        };
        for (i, &x) in positions.iter().enumerate() {
            let (window, u) = self.place(x);
            if window == 0.0 {
                out[i] = 0.0;
                continue;
            }
            (owners[count], windows[count], buffers.u[count]) = (i, window, u);
            count += 1;
            if count == BLOCK {
                flush(&mut buffers, &owners, &windows, out);
                count = 0;
            }
        }
        flush(&mut buffers, &owners[..count], &windows[..count], out);
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn density_bound(&self, min: Vec3, max: Vec3) -> Option<f32> {
        let [min, max] = [min, max].map(Vec3::as_dvec3);
        if !(min.is_finite() && max.is_finite()) {
            return None;
        }
        let [low, high] = match self.space.domain {
            Domain::Box(bounds) => [min, max].map(|x| (x - bounds.min()) / bounds.size() - 0.5),
            Domain::Contracted { radius, norm, .. } => {
                // Contraction stretches at most by a factor of 1 (L2) or 2 (L∞), so a ball around the box
                // stays inside a ball.
                let lipschitz = if norm == Norm::L2 { 1.0 } else { 2.0 } / (4.0 * radius);
                let center = self.space.domain.to_unit((0.5 * (min + max)).as_vec3())? - 0.5;
                let reach = lipschitz * 0.5 * (max - min).length() * (1.0 + 1e-6) + 1e-6;
                [center - reach, center + reach]
            }
        };
        self.window.is_empty(low, high).then_some(0.0)
    }

    fn suggested_step(&self) -> f64 {
        self.space.step()
    }

    fn memory(&self) -> usize {
        size_of_val(self.parameters.encoding.table.as_slice())
            + self.window.memory()
            + self.occupied.len()
            + size_of::<Self>()
    }
}

impl TrainedField for HashGrid {
    fn cameras(&self, intrinsics: &Intrinsics) -> Result<Option<Vec<Camera>>> {
        if let Some(fov) = intrinsics.fov_x.filter(|_| !self.cameras.is_empty()) {
            let found = format!("{} degrees", fov.to_degrees());
            return Err(Error::setting("angle of view", "none: the model stores the lenses of its cameras", found));
        }
        let sized = |named: &NamedCamera| intrinsics.resolution.map_or(named.camera, |size| named.camera.resized(size));
        Ok((!self.cameras.is_empty()).then(|| self.cameras.iter().map(sized).collect()))
    }

    fn training_cameras(&self) -> &[NamedCamera] {
        &self.cameras
    }

    fn training_noise(&self) -> Option<f64> {
        let noise = self.training.get("training_noise")?.as_f64()?;
        (noise > 0.0 && noise.is_finite()).then_some(noise)
    }

    fn natural_domain(&self) -> Domain {
        self.space.domain
    }

    fn describe(&self) -> String {
        let resolutions = self.config.resolutions();
        format!(
            "hash grid, {N_LEVELS} levels of {N_FEATURES_PER_LEVEL} features from {} to {} cells, \
             2^{} entries, {} f32 parameters",
            resolutions[0],
            resolutions[N_LEVELS - 1],
            self.config.log2_hashmap_size,
            self.parameters.encoding.table.as_flattened().len()
                + self.parameters.network.layers().iter().map(|layer| layer.len()).sum::<usize>(),
        )
    }
}

#[doc(hidden)]
pub mod slow;
#[cfg(test)]
mod tests;
