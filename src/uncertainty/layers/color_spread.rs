//! How differently the training images show the same place, on the vertices of a lattice.
//!
//! A surface that is where the model has it has much the same colour in every image (photo-consistency: Seitz & Dyer
//! 1999, "Photorealistic scene reconstruction by voxel coloring"). A model whose colours depend on the direction can
//! fit its images with a wrong surface, too: its residuals are small there, and the images' own colours differ. So do
//! those of a glossy surface.
//!
//! Letters: c̄ the mean colour of one image's pixels around a vertex; W their weight; v the spread.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;
use serde_json::{Value, json};

use super::super::file::Source;
use super::point_means::{Head, PointMeans};
use super::{Layer, Merge, Sections};
use crate::geometry::{Camera, Lattice};
use crate::octree::corners;
use crate::render::{Pixel, RenderedView};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// The spread of the training images' colours around each point.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorSpread(PointMeans);

impl ColorSpread {
    /// Finest level of the lattice. On coarser ones, an image's mean is of more than the place.
    pub const LEVEL: u8 = 7;

    /// Images agree on the colour of a place if v is no more than this: what the deviation of depth needs to be
    /// believed in scenes that images hardly determine (`experiments/depth.md`).
    pub const CONSISTENT: f64 = 0.05;

    /// Level of the lattice.
    #[must_use]
    pub fn level(&self) -> u8 {
        self.0.lattice().level()
    }

    /// Root mean square over all places, in colours from 0 to 1.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.0.mean().sqrt()
    }

    /// v, the standard deviation between the images of the colour around a scene point, root mean square of red, green
    /// and blue, in colours from 0 to 1. `None` where no two images show matter.
    #[must_use]
    pub fn at(&self, x: Vec3) -> Option<f64> {
        let known = self.0.around(x).filter_map(|(square, share)| Some((square?, share)));
        let [sum, weight] = known.fold([0.0; 2], |[sum, weight], (v, share)| [sum + share * v, weight + share]);
        (weight > 0.0).then(|| (sum / weight).sqrt())
    }

    /// v at the median depth of each pixel of a camera's view, `[height · width]`; NaN where nothing is shown, or where
    /// no two images show it.
    #[must_use]
    pub fn of_view(&self, camera: &Camera, pixel_offset: f64, view: &RenderedView) -> Vec<f64> {
        let of = |(pixel, x): (&Pixel, DVec3)| {
            if pixel.opacity > 0.0 { self.at(x.as_vec3()).unwrap_or(f64::NAN) } else { f64::NAN }
        };
        view.median_points(camera, pixel_offset).map(of).collect()
    }
}

impl Layer for ColorSpread {
    const NAME: &'static str = "color spread";
    /// It depends on the model and not on the rays, so that of one part is enough.
    const MERGE: Merge<Self> = Some(|sum, part| sum.or_else(|| part.cloned()));
    const WITHOUT: &'static str = "whether training images agree on colours is not known (uncertainty --images)";

    fn head(&self) -> Value {
        json!(self.0.head())
    }

    fn sections(&self, _to_be_merged: bool) -> Sections<'_> {
        let (points, squares) = self.0.contents();
        vec![("color points", Box::new(points)), ("color spread", Box::new(squares))]
    }

    fn read(head: Value, file: &mut Source) -> Result<Self> {
        let head: Head = file.head(Self::NAME, head)?;
        let contents = (file.section("color points")?, file.section("color spread")?);
        // Colours of images are from 0 to 1.
        PointMeans::checked(file.lattice.coarsened(Self::LEVEL), 1.0, head, contents)
            .map(Self)
            .map_err(|(expected, found)| file.malformed("section `color spread`", expected, found))
    }

    fn memory(&self) -> usize {
        self.0.memory()
    }

    fn info(&self) -> String {
        format!(
            "where they show the same place, training images differ by {:.4} of their range (root mean square); kept \
             on level {}",
            self.mean(),
            self.level()
        )
    }
}

/// Sums from which a [`ColorSpread`] is made, image by image.
#[derive(Debug)]
pub struct ColorSums {
    lattice: Lattice,
    /// By lattice point, over the images.
    sums: FxHashMap<[u32; 3], OfImages>,
}

/// Sums over images.
#[derive(Debug, Default, Clone, Copy)]
struct OfImages {
    /// Σ W c̄.
    colors: DVec3,
    /// Σ W |c̄|² / 3.
    squares: f64,
    /// Σ W and Σ W².
    weights: [f64; 2],
    images: u32,
}

impl OfImages {
    fn add(&mut self, color: DVec3, weight: f64) {
        self.colors += weight * color;
        self.squares += weight * color.length_squared() / 3.0;
        self.weights = [self.weights[0] + weight, self.weights[1] + weight * weight];
        self.images += 1;
    }

    /// Σ W |c̄ − Σ W c̄ / Σ W|² / 3, and the weight by which to divide it: then its mean over images of independent
    /// colours is their variance. `None` for a single image, which has no variance.
    fn spread(&self) -> Option<[f64; 2]> {
        let [sum, squares] = self.weights;
        let about_mean = self.squares - self.colors.length_squared() / (3.0 * sum);
        let weight = sum - squares / sum;
        (self.images > 1 && weight > 0.0).then_some([about_mean.max(0.0), weight])
    }
}

impl ColorSums {
    /// No images yet, on the lattice for fields on this one.
    #[must_use]
    pub fn new(of_field: &Lattice) -> Self {
        Self { lattice: of_field.coarsened(ColorSpread::LEVEL), sums: FxHashMap::default() }
    }

    /// Counts an image: the scene points that its pixels show, with their colours from 0 to 1.
    pub fn add_image(&mut self, pixels: impl IntoIterator<Item = (Vec3, DVec3)>) {
        let mut image = FxHashMap::<[u32; 3], (DVec3, f64)>::default();
        for (x, color) in pixels {
            let Some(u) = self.lattice.coordinates(x) else { continue };
            let (cell, offset) = self.lattice.cell(u);
            for (point, share) in corners(cell, offset).into_iter().filter(|(_, share)| *share > 0.0) {
                let (colors, weight) = image.entry(point).or_default();
                *colors += share * color;
                *weight += share;
            }
        }
        for (point, (colors, weight)) in image {
            self.sums.entry(point).or_default().add(colors / weight, weight);
        }
    }

    /// The spread; `None` if no two images show the same place.
    #[must_use]
    pub fn finish(self) -> Option<ColorSpread> {
        let mut spreads: Vec<([u32; 3], [f64; 2])> =
            self.sums.into_iter().filter_map(|(point, sums)| Some((point, sums.spread()?))).collect();
        // A sum in any other order could have other bits.
        spreads.sort_unstable_by_key(|(point, _)| *point);
        let [squares, weight] = spreads.iter().fold([0.0; 2], |sum, (_, [s, w])| [sum[0] + s, sum[1] + w]);
        let means = spreads.into_iter().map(|(point, [squares, weight])| (point, squares / weight));
        (weight > 0.0).then(|| ColorSpread(PointMeans::new(self.lattice, squares / weight, means)))
    }
}

impl UncertaintyField {
    /// How differently training images show the same place, if it is known.
    #[must_use]
    pub fn color_spread(&self) -> Option<&ColorSpread> {
        self.layers.color_spread.as_ref()
    }

    /// The same field with the spread of the training images' colours.
    ///
    /// # Errors
    /// If the field is on another lattice than that of the spread.
    pub fn with_color_spread(mut self, spread: ColorSpread) -> Result<Self> {
        if *spread.0.lattice() != self.lattice.coarsened(ColorSpread::LEVEL) {
            return Err(Error::setting("color spread", "one on the field's lattice", "another"));
        }
        self.layers.color_spread = Some(spread);
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::Aabb;

    fn lattice(level: u8) -> Lattice {
        Lattice::new(Aabb::centered_cube(1.0), level).unwrap()
    }

    #[test]
    fn one_image_says_nothing_and_two_say_how_they_differ() {
        let gray = |value: f64| DVec3::splat(value);
        for (level, own) in [(4, 4), (7, 7), (9, 7)] {
            let mut sums = ColorSums::new(&lattice(level));
            // Two vertices of all levels: weights are 1 and 0.
            let [here, there] = [Vec3::ZERO, Vec3::splat(0.5)];
            sums.add_image([(here, gray(0.4)), (here, gray(0.6)), (there, gray(0.9))]);
            assert!(ColorSums { lattice: lattice(own), sums: sums.sums.clone() }.finish().is_none());
            sums.add_image([(here, gray(0.8)), (here, gray(1.0))]);
            let found = sums.finish().unwrap();
            assert_eq!(found.level(), own);
            // Means 0.5 and 0.9, of weight 2 each: 4 · 0.2² over 4 − 8 / 4.
            let square = 0.4_f64.powi(2) / 2.0;
            let close = |v: f64| (v / square.sqrt() - 1.0).abs() < 1e-6;
            assert!(close(found.mean()) && close(found.at(here).unwrap()), "{found:?}");
            // Beside the vertex, where another is not known.
            assert!(close(found.at(Vec3::splat(0.001)).unwrap()));
            // Where one image shows something, and where none does.
            assert!([there, Vec3::splat(-0.5), Vec3::splat(9.0)].iter().all(|x| found.at(*x).is_none()));
        }
        assert!(ColorSums::new(&lattice(4)).finish().is_none());
    }

    proptest! {
        /// The variance between groups by its definition.
        #[test]
        fn spread_is_the_variance_between_images(
            images in {
                let pixel = (0.0..1.0_f64, 0.0..1.0_f64, any::<bool>());
                prop::collection::vec(prop::collection::vec(pixel, 1..5), 2..6)
            },
        ) {
            let places = [Vec3::ZERO, Vec3::splat(0.5)];
            let mut sums = ColorSums::new(&lattice(5));
            for image in &images {
                sums.add_image(image.iter().map(|&(r, g, is_second)| {
                    (places[usize::from(is_second)], DVec3::new(r, g, 0.3))
                }));
            }
            let of_place = |second: bool| {
                let mut means = Vec::new();
                for image in &images {
                    let here: Vec<DVec3> =
                        image.iter().filter(|p| p.2 == second).map(|p| DVec3::new(p.0, p.1, 0.3)).collect();
                    if !here.is_empty() {
                        means.push((here.iter().sum::<DVec3>() / here.len() as f64, here.len() as f64));
                    }
                }
                let all: f64 = means.iter().map(|(_, w)| w).sum();
                let mean = means.iter().map(|(c, w)| *w * *c).sum::<DVec3>() / all;
                let about: f64 = means.iter().map(|(c, w)| w * (*c - mean).length_squared() / 3.0).sum();
                let known: f64 = means.iter().map(|(_, w)| w * (1.0 - w / all)).sum();
                (means.len() > 1).then_some([about, known])
            };
            let of_places = [of_place(false), of_place(true)];
            let found = sums.finish();
            prop_assert_eq!(found.is_some(), of_places.iter().any(Option::is_some));
            if let Some(found) = found {
                let all = of_places.iter().flatten().fold([0.0; 2], |sum, [s, w]| [sum[0] + s, sum[1] + w]);
                prop_assert!((found.mean().powi(2) - all[0] / all[1]).abs() < 1e-6, "{found:?}, {all:?}");
                for (place, expected) in places.into_iter().zip(of_places) {
                    let [at, expected] = [found.at(place), expected.map(|[about, known]| (about / known).sqrt())];
                    prop_assert_eq!(at.is_some(), expected.is_some());
                    prop_assert!((at.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-6, "{at:?}, {expected:?}");
                }
            }
        }
    }
}
