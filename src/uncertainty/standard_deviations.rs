//! σ_v of every vertex.

/// Standard deviations by vertex, scene units.
///
/// They are computed in f64 and stored in f32, which changes log10 σ by at most 3e-8.
#[derive(Debug, Clone, PartialEq)]
pub struct StandardDeviations(pub(super) Vec<f32>);

impl StandardDeviations {
    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no vertices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// σ of vertex `v`.
    #[must_use]
    pub fn get(&self, v: usize) -> f64 {
        f64::from(self.0[v])
    }

    /// σ of all vertices.
    #[must_use]
    pub fn iter(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.0.iter().map(|&sigma| f64::from(sigma))
    }

    /// Bytes on the heap, spare capacity included.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.0.capacity() * size_of::<f32>()
    }
}
