//! Criteria for refining the octree.

use std::fmt;

/// A single criterion that asks for refinement or limits it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[non_exhaustive]
pub enum Criterion {
    /// Around vertices whose displacement would change some pixel
    Sensitivity,
    /// Wherever there is density, seen or not
    Density,
    /// No finer than the rays support: about --min-rays rays per vertex (4 if that is 0)
    RayCount,
    /// Everywhere: the vertices of the dense grid, for comparisons
    #[cfg_attr(feature = "cli", value(skip))]
    Uniform,
}

/// A combination of criteria: refine where any of the first three asks for it, but no finer than the rays support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct Criteria {
    /// [`Criterion::Sensitivity`].
    pub sensitivity: bool,
    /// [`Criterion::Density`].
    pub density: bool,
    /// [`Criterion::Uniform`].
    pub uniform: bool,
    /// [`Criterion::RayCount`].
    pub ray_count: bool,
}

impl Default for Criteria {
    fn default() -> Self {
        Self::from_iter([Criterion::Sensitivity])
    }
}

impl FromIterator<Criterion> for Criteria {
    fn from_iter<T: IntoIterator<Item = Criterion>>(criteria: T) -> Self {
        let mut all = Self { sensitivity: false, density: false, uniform: false, ray_count: false };
        for criterion in criteria {
            match criterion {
                Criterion::Sensitivity => all.sensitivity = true,
                Criterion::Density => all.density = true,
                Criterion::RayCount => all.ray_count = true,
                Criterion::Uniform => all.uniform = true,
            }
        }
        // The ray count only limits. By itself it limits refinement by sensitivity.
        all.sensitivity |= !all.density && !all.uniform;
        all
    }
}

impl fmt::Display for Criteria {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = [
            (self.sensitivity, "sensitivity"),
            (self.density, "density"),
            (self.uniform, "uniform"),
            (self.ray_count, "ray-count"),
        ];
        let names: Vec<&str> = all.iter().filter(|(on, _)| *on).map(|(_, name)| *name).collect();
        write!(f, "{}", names.join(", "))
    }
}
