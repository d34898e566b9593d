//! What pictures show of log10 U: nothing where a pixel shows hardly any matter, or matter outside the field's domain.

use glam::Vec3;

use super::{Answer, BakedField, Observability};
use crate::geometry::Camera;
use crate::render::{Pixel, RenderedView};

/// Pixels of this opacity or less are nearly transparent: their log10 U is undefined.
const MIN_OPACITY: f64 = 0.05;

/// Why U is undefined for a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// No training ray reached it.
    Unseen,
    /// It lies outside the field's domain.
    Outside,
}

/// Why U is undefined at the median depths of the pixels, `[height · width]`; `None` where it is defined.
/// `offset` is the position in a pixel that its ray passed through.
#[must_use]
pub fn unknowns(field: &BakedField, camera: &Camera, offset: f64, view: &RenderedView) -> Vec<Option<Unknown>> {
    let points: Vec<Vec3> = view.median_points(camera, offset).map(|(_, x)| x.as_vec3()).collect();
    let unknown = |(found, pixel): (Answer, &Pixel)| match found.observability {
        _ if !found.estimate.inside => (pixel.opacity > MIN_OPACITY).then_some(Unknown::Outside),
        Some(Observability::Unseen) if pixel.opacity > 0.5 => Some(Unknown::Unseen),
        _ => None,
    };
    field.answers(&points).into_iter().zip(&view.pixels).map(unknown).collect()
}

/// The log10 U that a picture shows, one of the view's ray averages, `[height · width]`: NaN where the opacity is 0.05
/// or less, and where the matter that is seen lies outside the field's domain. `unknown` is of [`unknowns`].
#[must_use]
pub fn shown_log10(view: &RenderedView, log10: &[f64], unknown: &[Option<Unknown>]) -> Vec<f64> {
    let is_shown = |pixel: &Pixel, why| pixel.opacity > MIN_OPACITY && why != Some(Unknown::Outside);
    let pixels = view.pixels.iter().zip(unknown).zip(log10);
    pixels.map(|((pixel, &why), &u)| if is_shown(pixel, why) { u } else { f64::NAN }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn veils_and_matter_outside_show_nothing() {
        let pixel = |opacity| Pixel { opacity, ..Pixel::default() };
        let opacities = [0.0, 1e-8, MIN_OPACITY, 0.051, 1.0, 1.0, 1.0];
        let view =
            RenderedView { resolution: [7, 1], pixels: opacities.map(pixel).to_vec(), ..RenderedView::default() };
        let log10 = [f64::NAN, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let mut unknown = [None; 7];
        (unknown[4], unknown[5]) = (Some(Unknown::Unseen), Some(Unknown::Outside));
        let shown = shown_log10(&view, &log10, &unknown);
        assert!(shown[..3].iter().all(|u| u.is_nan()) && shown[5].is_nan(), "{shown:?}");
        assert_eq!([shown[3], shown[4], shown[6]], [3.0, 4.0, 6.0]);
    }
}
