//! The plain MLP NeRF of Mildenhall et al. 2020 in the variant that nerf-pytorch (Krishna Murthy) trained.
//!
//! Letters: `x` encoded position (63 values), `d` encoded direction (27), `h` hidden layer (128 wide).
//!
//! ```text
//! x -> layer1 -> relu(layers_xyz.0..2) -> h -> fc_alpha -> σ = relu
//!                                         h -> relu(fc_feat) ++ d -> relu(layers_dir.0) -> fc_rgb -> sigmoid
//! ```
//! There is no activation behind `layer1` and no skip connection. Weights are `[out, in]`, y = W x + b.

use std::path::Path;

use glam::Vec3;
use ndarray::{Array1, Array2, ArrayViewMut2, Axis, linalg::general_mat_mul, s};
use safetensors::{Dtype, SafeTensors};

use super::{Radiance, RadianceField};
use crate::geometry::Aabb;
use crate::{Error, Result};

/// Octaves of the positional encoding for positions and directions.
const OCTAVES: [usize; 2] = [10, 4];
/// Encoded widths: 3 + 6 per octave.
const ENCODED: [usize; 2] = [3 + 6 * OCTAVES[0], 3 + 6 * OCTAVES[1]];
const HIDDEN: usize = 128;
/// Rows evaluated together: three buffers of 256 × 128 f32 stay in a core's second-level cache.
const BLOCK: usize = 256;
/// NeRF-synthetic scenes fit in this cube (half edge 0.5 / 0.33, the unit cube of instant-ngp); the file names no box.
const HALF_EDGE: f64 = 0.5 / 0.33;

/// One linear layer.
#[derive(Debug, Clone)]
struct Linear {
    /// `[out, in]`.
    weight: Array2<f32>,
    /// `[out]`.
    bias: Array1<f32>,
}

impl Linear {
    /// out = x Wᵀ + b for every row of `x`.
    fn apply(&self, x: &Array2<f32>, rows: usize, out: &mut Array2<f32>) {
        let mut out = out.slice_mut(s![..rows, ..]);
        general_mat_mul(1.0, &x.slice(s![..rows, ..]), &self.weight.t(), 0.0, &mut out);
        out += &self.bias;
    }

    fn apply_relu(&self, x: &Array2<f32>, rows: usize, out: &mut Array2<f32>) {
        self.apply(x, rows, out);
        out.slice_mut(s![..rows, ..]).mapv_inplace(|v| v.max(0.0));
    }
}

/// A trained coarse + fine MLP NeRF; the fine network is the field, the coarse one only served sampling in training.
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
    /// Reads the `fine.` network of a `.safetensors` file.
    ///
    /// # Errors
    /// If the file cannot be read, a tensor is missing or of another shape or type, or a weight is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(Error::io(path, "cannot read"))?;
        let tensors = SafeTensors::deserialize(&bytes)
            .map_err(|e| Error::malformed(path, "header", "a safetensors file", e.to_string()))?;
        let linear = |name: &str, outputs, inputs| {
            Ok(Linear {
                weight: Array2::from_shape_vec(
                    (outputs, inputs),
                    tensor(path, &tensors, name, "weight", &[outputs, inputs])?,
                )
                .expect("the shape was checked"),
                bias: Array1::from_vec(tensor(path, &tensors, name, "bias", &[outputs])?),
            })
        };
        let xyz = |i| linear(&format!("fine.layers_xyz.{i}"), HIDDEN, HIDDEN);
        Ok(Self {
            layer1: linear("fine.layer1", HIDDEN, ENCODED[0])?,
            layers_xyz: [xyz(0)?, xyz(1)?, xyz(2)?],
            fc_alpha: linear("fine.fc_alpha", 1, HIDDEN)?,
            fc_feat: linear("fine.fc_feat", HIDDEN, HIDDEN)?,
            layers_dir: linear("fine.layers_dir.0", 64, HIDDEN + ENCODED[1])?,
            fc_rgb: linear("fine.fc_rgb", 3, 64)?,
        })
    }

    /// Runs the density branch for up to [`BLOCK`] positions; leaves h in `hidden[1]` and σ before its relu in `alpha`.
    fn density_block(&self, positions: &[Vec3], scratch: &mut Scratch) {
        let rows = positions.len();
        encode(positions, OCTAVES[0], scratch.x.view_mut());
        let [a, b] = &mut scratch.hidden;
        self.layer1.apply(&scratch.x, rows, a);
        self.layers_xyz[0].apply_relu(a, rows, b);
        self.layers_xyz[1].apply_relu(b, rows, a);
        self.layers_xyz[2].apply_relu(a, rows, b);
        self.fc_alpha.apply(b, rows, &mut scratch.alpha);
    }

    /// Runs the colour branch behind [`Self::density_block`]; leaves colour before its sigmoid in `rgb`.
    fn color_block(&self, directions: &[Vec3], scratch: &mut Scratch) {
        let rows = directions.len();
        encode(directions, OCTAVES[1], scratch.d.view_mut());
        let [a, b] = &mut scratch.hidden;
        self.fc_feat.apply_relu(b, rows, a);
        scratch.joined.slice_mut(s![..rows, ..HIDDEN]).assign(&a.slice(s![..rows, ..]));
        scratch.joined.slice_mut(s![..rows, HIDDEN..]).assign(&scratch.d.slice(s![..rows, ..]));
        self.layers_dir.apply_relu(&scratch.joined, rows, &mut scratch.dir);
        self.fc_rgb.apply(&scratch.dir, rows, &mut scratch.rgb);
    }
}

/// One tensor of the expected shape, f32, finite.
fn tensor(path: &Path, tensors: &SafeTensors, layer: &str, part: &str, shape: &[usize]) -> Result<Vec<f32>> {
    let name = format!("{layer}.{part}");
    let expected =
        format!("f32 {shape:?} (a plain NeRF MLP with {} position and {} direction features)", ENCODED[0], ENCODED[1]);
    let view = tensors
        .tensor(&name)
        .map_err(|_| Error::malformed(path, format!("tensor `{name}`"), &expected, "no such tensor"))?;
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        let hint = if name == "fine.layer1.weight" && view.shape() == [HIDDEN, 39] {
            "; 39 position features mark a forward-facing model in NDC space, which has no scene box: not supported"
        } else {
            ""
        };
        let found = format!("{:?} {:?}{hint}", view.dtype(), view.shape());
        return Err(Error::malformed(path, format!("tensor `{name}`"), expected, found));
    }
    let values: Vec<f32> = view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => {
            let found = values[i].to_string();
            Err(Error::malformed(path, format!("tensor `{name}`, element {i}"), "a finite number", found))
        }
        None => Ok(values),
    }
}

/// enc(v) = [v, sin v, cos v, sin 2v, cos 2v, …], each a 3-vector, no factor π.
fn encode(vectors: &[Vec3], octaves: usize, mut out: ArrayViewMut2<f32>) {
    for (v, mut row) in vectors.iter().zip(out.axis_iter_mut(Axis(0))) {
        let row = row.as_slice_mut().expect("rows are contiguous");
        row[..3].copy_from_slice(&v.to_array());
        let mut frequency = 1.0;
        for octave in row[3..].chunks_exact_mut(6).take(octaves) {
            for axis in 0..3 {
                (octave[axis], octave[3 + axis]) = (frequency * v[axis]).sin_cos();
            }
            frequency *= 2.0;
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
            self.density_block(positions, &mut scratch);
            self.color_block(directions, &mut scratch);
            for (row, out) in out.iter_mut().enumerate() {
                // f32::max would turn a NaN into 0 and hide it from the count of non-finite samples.
                let raw = scratch.alpha[[row, 0]];
                out.density = if raw < 0.0 { 0.0 } else { raw };
                out.color = Vec3::from_array([0, 1, 2].map(|c| 1.0 / (1.0 + (-scratch.rgb[[row, c]]).exp())));
            }
        }
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        let mut scratch = Scratch::new();
        for (positions, out) in positions.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
            self.density_block(positions, &mut scratch);
            for (row, out) in out.iter_mut().enumerate() {
                let raw = scratch.alpha[[row, 0]];
                *out = if raw < 0.0 { 0.0 } else { raw };
            }
        }
    }

    fn suggested_step(&self) -> f64 {
        2.0 * HALF_EDGE / 512.0
    }

    fn pixel_offset(&self) -> f64 {
        0.0
    }

    fn memory(&self) -> usize {
        let layers =
            self.layers_xyz.iter().chain([&self.layer1, &self.fc_alpha, &self.fc_feat, &self.layers_dir, &self.fc_rgb]);
        layers.map(|l| 4 * (l.weight.len() + l.bias.len())).sum()
    }

    fn describe(&self) -> String {
        format!("NeRF MLP, 5 layers of {HIDDEN}, {} f32 parameters", self.memory() / 4)
    }
}

#[cfg(test)]
mod tests;
