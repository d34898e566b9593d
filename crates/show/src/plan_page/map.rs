//! A scene from one side, with its cameras.

use std::fmt::Write as _;

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::metrics::quantile;

use crate::comparison::data_url;
use crate::depth_page::escaped;

/// Longest side of a map, pixels.
const SIDE: f64 = 560.0;
/// Room around what is shown, as a share of its longest side.
const MARGIN: f64 = 0.06;
/// Share of the points that may lie beyond a map at each of its sides.
const OUTSIDE: f64 = 0.02;
/// How much of a point's colour is left on white ground, so that marks stand out.
const INK: f64 = 0.6;

/// A map.
#[derive(Debug, Clone)]
pub struct PlanMap {
    /// What it shows.
    pub caption: String,
    /// Its ground.
    pub image: RgbImage,
    /// The cameras that there are.
    pub existing: Vec<Mark>,
    /// Those that are planned, in their order.
    pub planned: Vec<Mark>,
}

/// A camera on a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Pixels from the left and from the top.
    pub at: DVec2,
    /// The unit direction of view as far as the map shows it: shorter if the camera looks along the map's own view.
    pub towards: DVec2,
}

impl PlanMap {
    /// The map whose right, top and viewer lie along these axes, of points with their colours. What is nearest to the
    /// viewer hides what is behind it.
    #[must_use]
    pub fn new(
        caption: &str,
        [right, top, near]: [DVec3; 3],
        points: &[(DVec3, [u8; 3])],
        existing: &[Camera],
        planned: &[Camera],
    ) -> Self {
        let flat = |x: DVec3| DVec2::new(x.dot(right), -x.dot(top));
        let [low, high] = extent(points, existing.iter().chain(planned), flat);
        let size = high - low;
        let scale = SIDE / size.max_element();
        let [width, height] = (scale * size).to_array().map(|n| (n.ceil() as u32).max(1));
        let place = |x: DVec3| scale * (flat(x) - low);
        let mut nearest = vec![f64::NEG_INFINITY; width as usize * height as usize];
        let mut image = RgbImage::from_pixel(width, height, Rgb([255; 3]));
        for (x, color) in points {
            let [column, row] = place(*x).to_array().map(|v| v.floor() as i64);
            // Points are pixels apart.
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (column + dx, row + dy)));
            for (column, row) in around.filter(|(c, r)| (0..width.into()).contains(c) && (0..height.into()).contains(r))
            {
                let index = row as usize * width as usize + column as usize;
                if x.dot(near) > nearest[index] {
                    nearest[index] = x.dot(near);
                    let faded = color.map(|v| (255.0 - INK * (255.0 - f64::from(v))).round() as u8);
                    image.put_pixel(column as u32, row as u32, Rgb(faded));
                }
            }
        }
        let mark = |camera: &Camera| Mark { at: place(camera.position), towards: flat(-camera.axes.z_axis) };
        Self {
            caption: caption.into(),
            image,
            existing: existing.iter().map(mark).collect(),
            planned: planned.iter().map(mark).collect(),
        }
    }

    /// The map with its marks, for a page.
    pub(super) fn svg(&self) -> Result<String> {
        let (width, height) = self.image.dimensions();
        let caption = escaped(&self.caption);
        let mut svg = format!(
            "<figure><svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" role=\"img\" \
             aria-label=\"{caption}\">\n<image href=\"{}\" width=\"{width}\" height=\"{height}\"/>\n",
            data_url(&self.image)?
        );
        for Mark { at, towards } in &self.existing {
            let end = *at + 14.0 * *towards;
            let _ = writeln!(
                svg,
                "<path class=\"taken\" d=\"M{:.1} {:.1}L{:.1} {:.1}\"/><circle class=\"taken\" cx=\"{:.1}\" \
                 cy=\"{:.1}\" r=\"3\"/>",
                at.x, at.y, end.x, end.y, at.x, at.y
            );
        }
        // The first above the others.
        for (k, Mark { at, towards }) in self.planned.iter().enumerate().rev() {
            let across = 0.45 * towards.perp();
            let [a, b] = [*towards + across, *towards - across].map(|way| *at + 40.0 * way);
            let _ = writeln!(
                svg,
                "<path class=\"planned\" d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\"/><circle class=\"planned\" \
                 cx=\"{:.1}\" cy=\"{:.1}\" r=\"11\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                at.x,
                at.y,
                a.x,
                a.y,
                b.x,
                b.y,
                at.x,
                at.y,
                at.x,
                at.y + 5.0,
                k + 1
            );
        }
        let _ = writeln!(svg, "</svg><figcaption>{caption}</figcaption></figure>");
        Ok(svg)
    }
}

/// The corners of what a map shows: nearly all points, all cameras, and room around them.
fn extent<'a>(
    points: &[(DVec3, [u8; 3])],
    cameras: impl Iterator<Item = &'a Camera>,
    flat: impl Fn(DVec3) -> DVec2,
) -> [DVec2; 2] {
    let places: Vec<DVec2> = cameras.map(|camera| flat(camera.position)).collect();
    let end = |axis: usize, share: f64| {
        let mut of_points: Vec<f64> = points.iter().map(|(x, _)| flat(*x)[axis]).collect();
        of_points.sort_unstable_by(f64::total_cmp);
        (!of_points.is_empty()).then(|| quantile(&of_points, share))
    };
    let corner = |share: f64, pick: fn(f64, f64) -> f64| {
        let along = |axis: usize| places.iter().map(|x| x[axis]).chain(end(axis, share)).reduce(pick).unwrap_or(0.0);
        DVec2::new(along(0), along(1))
    };
    let (low, high) = (corner(OUTSIDE, f64::min), corner(1.0 - OUTSIDE, f64::max));
    let longest = (high - low).max_element();
    let room = DVec2::splat(if longest > 0.0 { MARGIN * longest } else { 1.0 });
    [low - room, high + room]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_higher_hides_what_is_lower_and_marks_stand_where_cameras_do() {
        // A red floor, a blue table above its middle.
        let floor = (0..2500).map(|i| DVec3::new(f64::from(i % 50) / 25.0 - 1.0, f64::from(i / 50) / 25.0 - 1.0, 0.0));
        let mut points: Vec<(DVec3, [u8; 3])> = floor.map(|x| (x, [255, 0, 0])).collect();
        points.push((DVec3::new(0.0, 0.0, 0.5), [0, 0, 255]));
        let camera = Camera::look_at(DVec3::new(0.0, -2.0, 1.0), DVec3::new(0.0, 0.0, 1.0), DVec3::Z, 0.8, [4, 4]);
        let down = Camera::look_at(DVec3::new(0.5, 0.5, 2.0), DVec3::new(0.5, 0.500_001, 0.0), DVec3::Y, 0.8, [4, 4]);
        let map = PlanMap::new("from above", [DVec3::X, DVec3::Y, DVec3::Z], &points, &[camera], &[down]);
        let (width, height) = map.image.dimensions();
        // 2 by 3 and room: the floor from -1 to 1, a camera at -2.
        assert!(height == SIDE as u32 && (f64::from(width) / SIDE - 2.3 / 3.3).abs() < 0.05, "{width} x {height}");
        let scale = map.planned[0].at.distance(map.existing[0].at) / DVec2::new(0.5, 2.5).length();
        let middle = map.existing[0].at - DVec2::new(0.0, 2.0 * scale);
        let [column, row] = middle.to_array().map(|v| v as u32);
        assert_eq!(map.image.get_pixel(column, row).0, [102, 102, 255], "the table hides the floor");
        assert!(map.existing[0].towards.distance(DVec2::new(0.0, -1.0)) < 1e-9, "ahead is up on the page");
        assert!(map.planned[0].towards.length() < 1e-3, "a look straight down has no direction here");
        let svg = map.svg().unwrap();
        assert!(svg.matches("<circle").count() == 2 && svg.contains(">1</text>"));
        // Nothing to show, and one place.
        assert_eq!(
            PlanMap::new("", [DVec3::X, DVec3::Y, DVec3::Z], &[], &[camera], &[]).image.dimensions(),
            (560, 560)
        );
    }
}
