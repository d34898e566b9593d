//! The rows of J, ray by ray.

use rayon::prelude::*;

/// For every ray the vertices that it touches, and the derivatives of its colour by their displacements.
#[derive(Debug, Clone)]
pub struct Rows {
    /// `[rays + 1]`.
    offsets: Vec<usize>,
    /// `[entries]`.
    vertices: Vec<u32>,
    /// `[entries]`: ∂C_c/∂u_k at 3·c + k, 1 / scene unit.
    jacobians: Vec<[f32; 9]>,
}

impl Default for Rows {
    fn default() -> Self {
        Self { offsets: vec![0], vertices: Vec::new(), jacobians: Vec::new() }
    }
}

impl Rows {
    /// Appends a ray.
    pub fn push(&mut self, entries: impl Iterator<Item = (u32, [f32; 9])>) {
        for (vertex, jacobian) in entries {
            self.vertices.push(vertex);
            self.jacobians.push(jacobian);
        }
        self.offsets.push(self.vertices.len());
    }

    pub fn rays(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Vertices and derivatives of a ray.
    pub fn ray(&self, ray: usize) -> impl ExactSizeIterator<Item = (usize, &[f32; 9])> {
        let range = self.offsets[ray]..self.offsets[ray + 1];
        self.vertices[range.clone()].iter().map(|&v| v as usize).zip(&self.jacobians[range])
    }

    /// The entries by vertex.
    pub fn columns(&self, vertices: usize) -> Columns {
        let mut offsets = vec![0; vertices + 1];
        for &vertex in &self.vertices {
            offsets[vertex as usize + 1] += 1;
        }
        for v in 0..vertices {
            offsets[v + 1] += offsets[v];
        }
        let mut next = offsets.clone();
        let mut entries = vec![(0, 0); self.vertices.len()];
        for ray in 0..self.rays() {
            for entry in self.offsets[ray]..self.offsets[ray + 1] {
                let next = &mut next[self.vertices[entry] as usize];
                entries[*next] = (ray as u32, entry);
                *next += 1;
            }
        }
        Columns { offsets, entries }
    }

    /// J x for `width` vectors at once: from `[3 vertices][width]` to `[3 rays][width]`.
    pub fn times(&self, x: &[f64], width: usize) -> Vec<f64> {
        let mut out = vec![0.0; 3 * self.rays() * width];
        out.par_chunks_mut(3 * width).enumerate().for_each(|(ray, out)| {
            for (vertex, jacobian) in self.ray(ray) {
                let x = &x[3 * vertex * width..][..3 * width];
                for (channel, out) in out.chunks_mut(width).enumerate() {
                    for (axis, x) in x.chunks(width).enumerate() {
                        let j = f64::from(jacobian[3 * channel + axis]);
                        out.iter_mut().zip(x).for_each(|(out, x)| *out += j * x);
                    }
                }
            }
        });
        out
    }

    /// Jᵀ y for `width` vectors at once: from `[3 rays][width]` to `[3 vertices][width]`. Every vertex adds its rays in
    /// their order, whatever the number of threads.
    pub fn transposed_times(&self, columns: &Columns, y: &[f64], width: usize) -> Vec<f64> {
        let vertices = columns.offsets.len() - 1;
        let mut out = vec![0.0; 3 * vertices * width];
        out.par_chunks_mut(3 * width).enumerate().for_each(|(vertex, out)| {
            for &(ray, entry) in &columns.entries[columns.offsets[vertex]..columns.offsets[vertex + 1]] {
                let (y, jacobian) = (&y[3 * ray as usize * width..][..3 * width], &self.jacobians[entry]);
                for (axis, out) in out.chunks_mut(width).enumerate() {
                    for (channel, y) in y.chunks(width).enumerate() {
                        let j = f64::from(jacobian[3 * channel + axis]);
                        out.iter_mut().zip(y).for_each(|(out, y)| *out += j * y);
                    }
                }
            }
        });
        out
    }

    /// Σ_r J_vᵀ J_v of every vertex, with columns x, y, z.
    pub fn blocks(&self, columns: &Columns) -> Vec<glam::DMat3> {
        let block = |pair: &[usize]| {
            let entries = &columns.entries[pair[0]..pair[1]];
            // Row c of J is column c of what glam reads by columns.
            let square = |&(_, entry): &(u32, usize)| {
                let transposed = glam::DMat3::from_cols_array(&self.jacobians[entry].map(f64::from));
                transposed * transposed.transpose()
            };
            entries.iter().map(square).fold(glam::DMat3::ZERO, |sum, square| sum + square)
        };
        columns.offsets.windows(2).map(block).collect()
    }
}

/// Which rays touch a vertex.
#[derive(Debug, Clone)]
pub struct Columns {
    /// `[vertices + 1]`.
    offsets: Vec<usize>,
    /// `[entries]`: ray, and place of the entry in [`Rows`].
    entries: Vec<(u32, usize)>,
}

impl Columns {
    /// Number of unknowns: three for each vertex.
    pub fn unknowns(&self) -> usize {
        3 * (self.offsets.len() - 1)
    }
}
