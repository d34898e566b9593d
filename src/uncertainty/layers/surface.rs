//! Points on visible surfaces.

use serde_json::Value;

use super::super::file::Source;
use super::{Layer, Merge, Sections};
use crate::Result;
use crate::uncertainty::UncertaintyField;

impl Layer for Vec<[f32; 3]> {
    const NAME: &'static str = "surface points";
    /// Those of both; the caller limits their number.
    const MERGE: Merge<Self> = Some(|sum, part| match (sum, part) {
        (Some(sum), Some(part)) => Some([&sum[..], part].concat()),
        (sum, part) => sum.or_else(|| part.cloned()),
    });
    const WITHOUT: &'static str = "no points on surfaces";

    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        vec![("surface", Box::new(self.as_slice()))]
    }

    fn read(_head: Value, file: &mut Source) -> Result<Self> {
        let points: Self = file.section("surface")?;
        if let Some(i) = points.iter().position(|x| !x.iter().all(|v| v.is_finite())) {
            let place = format!("section `surface`, point {i}");
            return Err(file.malformed(place, "finite coordinates", format!("{:?}", points[i])));
        }
        Ok(points)
    }

    fn memory(&self) -> usize {
        self.capacity() * size_of::<[f32; 3]>()
    }

    fn info(&self) -> String {
        format!("{} points for compare and --threshold 99%", self.len())
    }
}

impl UncertaintyField {
    /// The same field with the given points on visible surfaces.
    #[must_use]
    pub fn with_surface(mut self, surface: Vec<[f32; 3]>) -> Self {
        self.layers.surface = Some(surface).filter(|points| !points.is_empty());
        self
    }

    /// `[n]`: points on visible surfaces.
    #[must_use]
    pub fn surface(&self) -> &[[f32; 3]] {
        self.layers.surface.as_deref().unwrap_or_default()
    }
}
