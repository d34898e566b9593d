//! The plain MLP NeRF of Mildenhall et al. 2020, in the variant trained by nerf-pytorch (Krishna Murthy).
//!
//! Letters: `x` encoded position (63 values), `d` encoded direction (27), `h` hidden layer (128 wide).
//!
//! ```text
//! x -> layer1 -> relu(layers_xyz.0..2) -> h -> fc_alpha -> σ = relu
//!                                         h -> relu(fc_feat) ++ d -> relu(layers_dir.0) -> fc_rgb -> sigmoid
//! ```
//! `layer1` has no activation and there is no skip connection. Weights are `[out, in]`, y = W x + b.

mod file;

use std::path::Path;

use glam::Vec3;
use multiversion::multiversion;
use ndarray::{Array1, Array2, Axis, linalg::general_mat_mul, s};

use self::file::File;
pub use self::file::is_checkpoint;
use crate::elementary::sin_cos;
use octobayes::Result;
use octobayes::field::{Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
use octobayes::geometry::Aabb;
use octobayes_data::NGP_SCALE;

/// Octaves of the positional encoding for positions and directions.
const OCTAVES: [usize; 2] = [10, 4];
/// Encoded widths: 3 values, plus 6 per octave.
const ENCODED: [usize; 2] = [3 + 6 * OCTAVES[0], 3 + 6 * OCTAVES[1]];
const HIDDEN: usize = 128;
/// Number of rows evaluated together. Weights are packed seldom, and three buffers of 512 × 128 f32 stay in a
/// core's second-level cache.
///
/// A row is a point, or one of the [`JET`] rows of a point that is differentiated.
const BLOCK: usize = 512;
/// Rows of a point with its derivatives: value, ∂x, ∂y, ∂z.
const JET: usize = 4;
/// Half edge of a cube in which NeRF-synthetic scenes fit, the unit cube of instant-ngp. The file names no box.
const HALF_EDGE: f64 = 0.5 / NGP_SCALE;

/// One linear layer.
#[derive(Debug, Clone)]
struct Linear {
    /// `[in, out]`: transposed for matrix products.
    weight: Array2<f32>,
    /// `[out]`.
    bias: Array1<f32>,
}

impl Linear {
    /// out = x Wᵀ + b for the first `rows` rows of `x`. Of [`JET`] rows only the first has the bias; the
    /// others are derivatives.
    fn apply<const ROWS: usize>(&self, x: &Array2<f32>, rows: usize, out: &mut Array2<f32>) {
        let mut out = out.slice_mut(s![..rows, ..]);
        for (i, mut row) in out.axis_iter_mut(Axis(0)).enumerate() {
            if i % ROWS == 0 {
                row.assign(&self.bias);
            } else {
                row.fill(0.0);
            }
        }
        general_mat_mul(1.0, &x.slice(s![..rows, ..]), &self.weight, 1.0, &mut out);
    }

    fn apply_relu<const ROWS: usize>(&self, x: &Array2<f32>, rows: usize, out: &mut Array2<f32>) {
        self.apply::<ROWS>(x, rows, out);
        let width = out.ncols();
        let values = out.as_slice_mut().expect("buffers are contiguous");
        for point in values[..rows * width].chunks_exact_mut(ROWS * width) {
            relu::<ROWS>(point, width);
        }
    }
}

/// Sets negative values and their derivatives to 0. NaN stays NaN.
fn relu<const ROWS: usize>(point: &mut [f32], width: usize) {
    let (values, derivatives) = point.split_at_mut(width);
    for row in derivatives.chunks_exact_mut(width) {
        for (derivative, value) in row.iter_mut().zip(&*values) {
            *derivative = if *value < 0.0 { 0.0 } else { *derivative };
        }
    }
    for value in values {
        *value = if *value < 0.0 { 0.0 } else { *value };
    }
}

/// A trained coarse and fine MLP NeRF. The fine network is the field; the coarse one only served sampling in training.
#[derive(Debug, Clone)]
pub struct NerfMlp {
    layer1: Linear,
    layers_xyz: [Linear; 3],
    fc_alpha: Linear,
    fc_feat: Linear,
    layers_dir: Linear,
    fc_rgb: Linear,
}

/// Buffers of one block.
struct Scratch {
    x: Array2<f32>,
    d: Array2<f32>,
    hidden: [Array2<f32>; 2],
    alpha: Array2<f32>,
    joined: Array2<f32>,
    dir: Array2<f32>,
    rgb: Array2<f32>,
}

impl Scratch {
    fn new() -> Self {
        let zeros = |width| Array2::zeros((BLOCK, width));
        Self {
            x: zeros(ENCODED[0]),
            d: zeros(ENCODED[1]),
            hidden: [zeros(HIDDEN), zeros(HIDDEN)],
            alpha: zeros(1),
            joined: zeros(HIDDEN + ENCODED[1]),
            dir: zeros(64),
            rgb: zeros(3),
        }
    }
}

impl NerfMlp {
    /// Reads the fine network of a `.safetensors` file (`fine.*`), or of a checkpoint of nerf-pytorch
    /// (`model_fine_state_dict.*`; `.ckpt`, `.pt`, `.pth` or `.tar`, zipped or from before PyTorch 1.6).
    ///
    /// # Errors
    /// If the file cannot be read, a tensor is missing or of another shape or type, or a weight is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        // A checkpoint has the state of its optimiser, too, which nobody needs in memory.
        let bytes = if is_checkpoint(path) { Vec::new() } else { octobayes::io::read(path)? };
        let file = File::open(path, &bytes)?;
        let linear = |name: &str, outputs, inputs| {
            let weight = file.tensor(path, name, "weight", &[outputs, inputs])?;
            let weight = Array2::from_shape_vec((outputs, inputs), weight).expect("the shape was checked");
            Ok(Linear {
                weight: weight.t().as_standard_layout().into_owned(),
                bias: Array1::from_vec(file.tensor(path, name, "bias", &[outputs])?),
            })
        };
        let xyz = |i| linear(&format!("layers_xyz.{i}"), HIDDEN, HIDDEN);
        Ok(Self {
            layer1: linear("layer1", HIDDEN, ENCODED[0])?,
            layers_xyz: [xyz(0)?, xyz(1)?, xyz(2)?],
            fc_alpha: linear("fc_alpha", 1, HIDDEN)?,
            fc_feat: linear("fc_feat", HIDDEN, HIDDEN)?,
            layers_dir: linear("layers_dir.0", 64, HIDDEN + ENCODED[1])?,
            fc_rgb: linear("fc_rgb", 3, 64)?,
        })
    }

    /// Runs the density branch for up to [`BLOCK`] / ROWS positions. Leaves h in `hidden[1]` and σ before its
    /// relu in `alpha`.
    fn density_block<const ROWS: usize>(&self, positions: &[Vec3], scratch: &mut Scratch) {
        let rows = ROWS * positions.len();
        encode_block::<ROWS>(positions, OCTAVES[0], scratch.x.as_slice_mut().expect("buffers are contiguous"));
        let [a, b] = &mut scratch.hidden;
        self.layer1.apply::<ROWS>(&scratch.x, rows, a);
        self.layers_xyz[0].apply_relu::<ROWS>(a, rows, b);
        self.layers_xyz[1].apply_relu::<ROWS>(b, rows, a);
        self.layers_xyz[2].apply_relu::<ROWS>(a, rows, b);
        self.fc_alpha.apply::<ROWS>(b, rows, &mut scratch.alpha);
    }

    /// Runs the colour branch after [`Self::density_block`]. Leaves colour before its sigmoid in `rgb`.
    fn color_block<const ROWS: usize>(&self, directions: &[Vec3], scratch: &mut Scratch) {
        let rows = ROWS * directions.len();
        encode_block::<1>(directions, OCTAVES[1], scratch.d.as_slice_mut().expect("buffers are contiguous"));
        let [a, b] = &mut scratch.hidden;
        self.fc_feat.apply_relu::<ROWS>(b, rows, a);
        let mut joined = scratch.joined.slice_mut(s![..rows, ..]);
        joined.slice_mut(s![.., ..HIDDEN]).assign(&a.slice(s![..rows, ..]));
        joined.slice_mut(s![.., HIDDEN..]).fill(0.0);
        // The direction is fixed, so it has no derivatives.
        joined.slice_mut(s![..;ROWS, HIDDEN..]).assign(&scratch.d.slice(s![..directions.len(), ..]));
        self.layers_dir.apply_relu::<ROWS>(&scratch.joined, rows, &mut scratch.dir);
        self.fc_rgb.apply::<ROWS>(&scratch.dir, rows, &mut scratch.rgb);
    }
}

/// σ from the network's output. f32::max would turn NaN into 0 and hide it from the count of non-finite samples.
fn density(raw: f32) -> f32 {
    if raw < 0.0 { 0.0 } else { raw }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Fills enc(v) = [v, sin v, cos v, sin 2v, cos 2v, …], each a 3-vector, without a factor π.
///
/// The shape is `[vector · ROWS + row][3 + 6 octaves]`. With [`JET`] rows the derivatives follow the value.
#[multiversion(targets("x86_64+avx2+fma"))]
fn encode_block<const ROWS: usize>(vectors: &[Vec3], octaves: usize, out: &mut [f32]) {
    let width = 3 + 6 * octaves;
    for (v, rows) in vectors.iter().zip(out.chunks_exact_mut(ROWS * width)) {
        // All angles come first, so that their sines become vector code.
        let (mut angle, mut sin, mut cos) = ([0.0; 3 * OCTAVES[0]], [0.0; 3 * OCTAVES[0]], [0.0; 3 * OCTAVES[0]]);
        let mut frequency = 1.0;
        for octave in angle.chunks_exact_mut(3) {
            for axis in 0..3 {
                octave[axis] = frequency * v[axis];
            }
            frequency *= 2.0;
        }
        for i in 0..angle.len() {
            (sin[i], cos[i]) = sin_cos(angle[i]);
        }
        rows[..3].copy_from_slice(&v.to_array());
        for (k, octave) in rows[3..width].chunks_exact_mut(6).enumerate() {
            octave[..3].copy_from_slice(&sin[3 * k..3 * k + 3]);
            octave[3..].copy_from_slice(&cos[3 * k..3 * k + 3]);
        }
        for (axis, row) in rows[width..].chunks_exact_mut(width).enumerate() {
            row.fill(0.0);
            row[axis] = 1.0;
            let mut frequency = 1.0;
            for (k, octave) in row[3..].chunks_exact_mut(6).enumerate() {
                octave[axis] = frequency * cos[3 * k + axis];
                octave[3 + axis] = -frequency * sin[3 * k + axis];
                frequency *= 2.0;
            }
        }
    }
}

impl RadianceField for NerfMlp {
    fn bounds(&self) -> Aabb {
        Aabb::centered_cube(HALF_EDGE)
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        let mut scratch = Scratch::new();
        for ((positions, directions), out) in
            positions.chunks(BLOCK).zip(directions.chunks(BLOCK)).zip(out.chunks_mut(BLOCK))
        {
            self.density_block::<1>(positions, &mut scratch);
            self.color_block::<1>(directions, &mut scratch);
            for (row, out) in out.iter_mut().enumerate() {
                out.density = density(scratch.alpha[[row, 0]]);
                out.color = Vec3::from_array([0, 1, 2].map(|c| sigmoid(scratch.rgb[[row, c]])));
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let mut scratch = Scratch::new();
        for (positions, out) in positions.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
            self.density_block::<1>(positions, &mut scratch);
            for (row, out) in out.iter_mut().enumerate() {
                *out = density(scratch.alpha[[row, 0]]);
            }
        }
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        Some(self)
    }

    fn suggested_step(&self) -> f64 {
        2.0 * HALF_EDGE / 512.0
    }

    fn memory(&self) -> usize {
        let layers =
            self.layers_xyz.iter().chain([&self.layer1, &self.fc_alpha, &self.fc_feat, &self.layers_dir, &self.fc_rgb]);
        layers.map(|l| 4 * (l.weight.len() + l.bias.len())).sum()
    }
}

impl TrainedField for NerfMlp {
    fn pixel_offset(&self) -> f64 {
        0.0
    }

    fn describe(&self) -> String {
        format!("NeRF MLP, 5 layers of {HIDDEN}, {} f32 parameters", self.memory() / 4)
    }
}

impl Differentiable for NerfMlp {
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        const POINTS: usize = BLOCK / JET;
        let mut scratch = Scratch::new();
        for ((positions, directions), out) in
            positions.chunks(POINTS).zip(directions.chunks(POINTS)).zip(out.chunks_mut(POINTS))
        {
            self.density_block::<JET>(positions, &mut scratch);
            self.color_block::<JET>(directions, &mut scratch);
            for (p, out) in out.iter_mut().enumerate() {
                (out.value.density, out.density_gradient) = density_jet(&scratch.alpha, p);
                let rgb = |row: usize| Vec3::from_array([0, 1, 2].map(|c| scratch.rgb[[JET * p + row, c]]));
                let color = Vec3::from_array(rgb(0).to_array().map(sigmoid));
                out.value.color = color;
                out.color_gradients = [1, 2, 3].map(|row| color * (1.0 - color) * rgb(row));
            }
        }
    }

    fn density_jets(&self, positions: &[Vec3], densities: &mut [f32], gradients: &mut [Vec3]) {
        const POINTS: usize = BLOCK / JET;
        let mut scratch = Scratch::new();
        for ((positions, densities), gradients) in
            positions.chunks(POINTS).zip(densities.chunks_mut(POINTS)).zip(gradients.chunks_mut(POINTS))
        {
            self.density_block::<JET>(positions, &mut scratch);
            for (p, (density, gradient)) in densities.iter_mut().zip(gradients).enumerate() {
                (*density, *gradient) = density_jet(&scratch.alpha, p);
            }
        }
    }
}

/// σ and ∇σ of point `p` of a block.
fn density_jet(alpha: &Array2<f32>, p: usize) -> (f32, Vec3) {
    let raw = alpha[[JET * p, 0]];
    let gradient = Vec3::from_array([1, 2, 3].map(|row| alpha[[JET * p + row, 0]]));
    (density(raw), if raw < 0.0 { Vec3::ZERO } else { gradient })
}

#[cfg(test)]
mod tests;
