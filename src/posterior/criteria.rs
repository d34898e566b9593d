//! Where the octree is refined.

use std::fmt;

/// One reason to refine, or not to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Criterion {
    /// Around vertices whose displacement some pixel would notice
    Sensitivity,
    /// Where there is density, seen or not
    Density,
    /// No finer than the rays can support: about --min-rays rays a vertex (4, if that is 0)
    RayCount,
    /// Everywhere: the dense grid's vertices
    Uniform,
}

/// A combination: refine where any of the first three says so, no finer than evidence supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Criteria {
    /// [`Criterion::Sensitivity`].
    pub sensitivity: bool,
    /// [`Criterion::Density`].
    pub density: bool,
    /// [`Criterion::Uniform`].
    pub uniform: bool,
    /// [`Criterion::Evidence`].
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
        // Evidence limits; alone it limits what rays are sensitive to.
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
