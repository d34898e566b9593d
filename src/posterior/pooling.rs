//! Whether a vertex near few rays borrows from its neighbours.

/// To pooling, a vertex has moved if its own information changes log10 U by more than this, decades. It does
/// not depend on the octree's tolerance: whether a vertex counts changes its neighbours by decades.
pub const MIN_CHANGE: f64 = 0.01;

choices! {
    /// Whether a vertex near few rays borrows from its neighbours.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
    pub enum Pooling {
        #[default]
        Off = "off", "Every vertex has its own sums alone, as in the paper";
        Auto = "auto", "The fewer rays saw it, the more it takes from what surrounds it";
    }
}

impl Pooling {
    /// Whether sums are pooled.
    #[must_use]
    pub fn is_on(self) -> bool {
        self != Self::Off
    }

    /// Whether a field of such sums is made of a copy of all of them: of a part of a run, to keep them, or to pool
    /// them.
    #[must_use]
    pub fn gathers_sums(self, is_part: bool, keep_sums: bool) -> bool {
        is_part || keep_sums || self.is_on()
    }

    /// Largest change of log10 U by what an octree of this `tolerance` leaves out.
    #[must_use]
    pub fn largest_change(self, tolerance: f64) -> f64 {
        if self.is_on() { MIN_CHANGE } else { tolerance }
    }
}
