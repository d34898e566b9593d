//! What training views show of each part, and where it stands to the surfaces that they show.

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::monitor::Monitor;
use octobayes_splats::{MIN_TRANSMITTANCE, MOST_OPAQUE, Splats, stride_for};
use rayon::prelude::*;

use crate::splats::list_splats;
use crate::views::{Listed, ListedRow, ListedView, Views};

/// A part is nearer than a surface if it is so by more than this share of the surface's depth.
pub const SLACK: f64 = 0.01;
/// A pixel that shows less light than this shows empty space.
const EMPTY: f64 = 0.5;
/// Where less light is left, more parts may be behind those that are listed: the next one may have taken 99 % of it.
const CUT: f64 = MIN_TRANSMITTANCE / (1.0 - MOST_OPAQUE);
/// Least weight in a view by which it can contradict a part.
const LEAST: f64 = 1e-3;
/// A view shows a part if the part's share of one of its pixels exceeds this.
pub const SHOWN: f64 = 0.05;
/// Steps between pixels that are looked at, to either side of the one nearest to a centre.
const WINDOW: i64 = 1;

/// What the views show of each of n parts, splats or cells of a volume; every list is `[n]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Σ w, the part's share of a pixel, over the pixels that were looked at.
    pub weight: Vec<f64>,
    /// What of it is nearer than the surface of its pixel.
    pub front: Vec<f64>,
    /// What of it is in pixels that show empty space: less than half of their light is reached.
    pub empty: Vec<f64>,
    /// Views in which more than half of the weight is nearer than surfaces.
    pub against: Vec<u32>,
    /// The largest w.
    pub peak: Vec<f32>,
    /// Views with a w above 0.05.
    pub views: Vec<u32>,
    /// Views whose image the centre is in.
    pub inside: Vec<u32>,
    /// Views whose image it would be in, but for the mask.
    pub masked: Vec<u32>,
    /// Views in which the centre is nearer than every surface beside it, or they show empty space.
    pub before: Vec<u32>,
    /// Views in which the centre is at the surface: neither nearer than all of these nor farther.
    pub on: Vec<u32>,
}

impl Evidence {
    /// Looks at up to `pixels` pixels of all cameras together, evenly spread over each image. Returns how many these
    /// are as well.
    ///
    /// # Errors
    /// If a lens distorts, or [`Error::Interrupted`](octobayes::Error::Interrupted).
    pub fn measure(
        splats: &Splats,
        cameras: &[Camera],
        pixel_offset: f64,
        pixels: u64,
        monitor: &dyn Monitor,
    ) -> Result<(Self, u64)> {
        let stride = stride_for(cameras.iter().map(Camera::pixels).sum(), pixels);
        let views = Views { cameras, masks: &[], pixel_offset, stride, every: 1 };
        let (mut sums, kept) = (vec![Sums::default(); splats.len()], vec![true; splats.len()]);
        let mut looked_at = 0;
        let all = Parts { centers: splats.means(), reach: &[], by_window: false };
        list_splats(&views, splats, monitor, |view| {
            looked_at += view.pixels();
            add(&mut sums, &view, all, &kept);
        })?;
        Ok((Self::from_sums(&sums), looked_at))
    }

    /// What the views show of the parts that are `kept` (`[n]`), without the others.
    pub(crate) fn of(views: &[ListedView], parts: Parts, kept: &[bool]) -> Self {
        let mut sums = vec![Sums::default(); parts.centers.len()];
        views.iter().for_each(|view| add(&mut sums, view, parts, kept));
        Self::from_sums(&sums)
    }

    fn from_sums(sums: &[Sums]) -> Self {
        let each = |value: fn(&Sums) -> f64| sums.iter().map(value).collect();
        let count = |value: fn(&Sums) -> u32| sums.iter().map(value).collect();
        Self {
            weight: each(|sums| sums.weight),
            front: each(|sums| sums.front),
            empty: each(|sums| sums.empty),
            against: count(|sums| sums.against),
            peak: sums.iter().map(|sums| sums.peak).collect(),
            views: count(|sums| sums.views),
            inside: count(|sums| sums.inside),
            masked: count(|sums| sums.masked),
            before: count(|sums| sums.before),
            on: count(|sums| sums.on),
        }
    }

    /// The share of part `i`'s weight that is nearer than the surfaces of its pixels; 0 without weight.
    ///
    /// The share in pixels that show empty space counts as well if there is a view in which most of the weight is
    /// nearer than surfaces: alone, it may be the rim of an object, or one with holes.
    #[must_use]
    pub fn front_share(&self, i: usize) -> f64 {
        if self.against[i] > 0 { self.free_share(i) } else { self.share(i, self.front[i]) }
    }

    /// The share of part `i`'s weight that is nearer than surfaces or in pixels of empty space; 0 without weight.
    #[must_use]
    pub fn free_share(&self, i: usize) -> f64 {
        self.share(i, self.front[i] + self.empty[i])
    }

    fn share(&self, i: usize, part: f64) -> f64 {
        if self.weight[i] > 0.0 { part / self.weight[i] } else { 0.0 }
    }
}

/// Where parts are.
#[derive(Clone, Copy)]
pub(crate) struct Parts<'a> {
    /// `[n]`: scene units.
    pub centers: &'a [Vec3],
    /// `[n]`: how far before a surface a part may still be of it, scene units, on top of [`SLACK`]; empty if 0.
    pub reach: &'a [f32],
    /// Whether a part counts as nearer only than the surfaces of the pixels beside it as well.
    pub by_window: bool,
}

impl Parts<'_> {
    fn reach(&self, part: usize) -> f64 {
        self.reach.get(part).map_or(0.0, |reach| f64::from(*reach))
    }
}

/// Adds what a view shows.
fn add(sums: &mut [Sums], view: &ListedView, parts: Parts, kept: &[bool]) {
    let of_row = |row: &ListedRow| {
        let (mut shares, mut depths) = (Vec::new(), Vec::new());
        for (column, pixel) in row.pixels().enumerate() {
            let first = shares.len();
            depths.push(pixel.map_or(f32::NAN, |hits| composite(hits, kept, &mut shares)));
            shares[first..].iter_mut().for_each(|share: &mut Share| share.column = column as u32);
        }
        (shares, depths)
    };
    let (shares, depths): (Vec<Vec<Share>>, Vec<Vec<f32>>) = view.rows.par_iter().map(of_row).unzip();
    let map = DepthMap { depths, start: view.start, stride: view.stride };
    let places: Vec<Vec<Place>> =
        shares.par_iter().enumerate().map(|(row, shares)| map.places(row, shares, parts)).collect();
    // Rows in their order, so that sums do not depend on threads.
    for (Share { part, weight, .. }, place) in shares.iter().flatten().zip(places.iter().flatten()) {
        let (found, weight) = (&mut sums[*part as usize].now, f64::from(*weight));
        found.weight += weight;
        found.peak = found.peak.max(weight as f32);
        match place {
            Place::Front => found.front += weight,
            Place::Empty => found.empty += weight,
            Place::Surface => {}
        }
    }
    let finish = |(i, ((sums, x), kept)): (usize, ((&mut Sums, &Vec3), &bool))| {
        if *kept {
            sums.end_view(map.stand(&view.camera, x.as_dvec3(), parts.reach(i)));
        }
    };
    sums.par_iter_mut().zip(parts.centers).zip(kept).enumerate().with_min_len(4096).for_each(finish);
}

/// Sums over the pixels of one view.
#[derive(Clone, Default)]
struct OfView {
    weight: f64,
    front: f64,
    empty: f64,
    peak: f32,
}

/// What the views show of one part; see [`Evidence`].
#[derive(Clone, Default)]
struct Sums {
    /// Of the view that is being looked at.
    now: OfView,
    weight: f64,
    front: f64,
    empty: f64,
    peak: f32,
    against: u32,
    views: u32,
    inside: u32,
    masked: u32,
    before: u32,
    on: u32,
}

impl Sums {
    fn end_view(&mut self, stand: Option<Stand>) {
        let OfView { weight, front, empty, peak } = std::mem::take(&mut self.now);
        self.weight += weight;
        self.front += front;
        self.empty += empty;
        self.peak = self.peak.max(peak);
        self.views += u32::from(f64::from(peak) > SHOWN);
        self.against += u32::from(weight > LEAST && front > 0.5 * weight);
        self.inside += u32::from(stand.is_some_and(|stand| stand != Stand::Masked));
        self.masked += u32::from(stand == Some(Stand::Masked));
        self.before += u32::from(stand == Some(Stand::Before));
        self.on += u32::from(stand == Some(Stand::On));
    }
}

/// What a part is of a pixel.
struct Share {
    part: u32,
    /// Of the pixel, in its row.
    column: u32,
    weight: f32,
    depth: f32,
}

/// Where a part is in a pixel.
#[derive(Clone, Copy)]
enum Place {
    /// Nearer than its surface.
    Front,
    /// At the surface, behind it, or it is not known.
    Surface,
    /// There is none.
    Empty,
}

/// Appends the shares of a pixel, and returns the depth of its surface: where half of the light is reached that comes
/// from any part, or infinity if that is little. NaN if it is not known: lists end where hardly any light is left, and
/// most of that was taken by parts that are not kept.
fn composite(hits: &[Listed], kept: &[bool], shares: &mut Vec<Share>) -> f32 {
    let all = || hits.iter().filter(|hit| kept[hit.part as usize]);
    let passed: f64 = all().map(|hit| 1.0 - f64::from(hit.alpha)).product();
    let passed_all: f64 = hits.iter().map(|hit| 1.0 - f64::from(hit.alpha)).product();
    let (mut surface, mut transmittance) = (f32::INFINITY, 1.0);
    for hit in all() {
        let weight = transmittance * f64::from(hit.alpha);
        transmittance -= weight;
        if surface.is_infinite() && 1.0 - passed >= EMPTY && 1.0 - transmittance >= 0.5 * (1.0 - passed) {
            surface = hit.depth;
        }
        shares.push(Share { part: hit.part, column: 0, weight: weight as f32, depth: hit.depth });
    }
    if surface.is_infinite() && passed_all < CUT { f32::NAN } else { surface }
}

/// Depths of the surfaces of an image's pixels.
struct DepthMap {
    /// By row and column of the pixels that were looked at; infinite where they show empty space, NaN where the mask
    /// leaves one out.
    depths: Vec<Vec<f32>>,
    start: u32,
    stride: u32,
}

/// Where a centre stands to the surfaces around it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stand {
    Before,
    On,
    Behind,
    /// The mask leaves out the pixels around it, or what they show is not known.
    Masked,
}

impl DepthMap {
    /// Where the parts of a row's pixels are.
    fn places(&self, row: usize, shares: &[Share], parts: Parts) -> Vec<Place> {
        let of_pixel = |shares: &[Share]| {
            let column = shares[0].column;
            let surface = self.depths[row][column as usize];
            let nearest = if parts.by_window {
                self.window([i64::from(column), row as i64]).fold(f64::INFINITY, f64::min)
            } else {
                f64::from(surface)
            };
            let place = |share: &Share| {
                let farthest = f64::from(share.depth) + parts.reach(share.part as usize);
                match () {
                    () if surface.is_nan() => Place::Surface,
                    () if nearest.is_infinite() => Place::Empty,
                    () if farthest < (1.0 - SLACK) * nearest => Place::Front,
                    () if surface.is_infinite() => Place::Empty,
                    () => Place::Surface,
                }
            };
            shares.iter().map(place).collect::<Vec<_>>()
        };
        shares.chunk_by(|a, b| a.column == b.column).flat_map(of_pixel).collect()
    }

    /// The surfaces that are known of a pixel and those beside it.
    fn window(&self, [column, row]: [i64; 2]) -> impl Iterator<Item = f64> {
        let around = |v: i64| (v - WINDOW).max(0)..=v + WINDOW;
        let rows = around(row).filter_map(|row| self.depths.get(row as usize));
        let depths = rows.flat_map(move |row| around(column).filter_map(|column| row.get(column as usize)));
        depths.filter(|depth| !depth.is_nan()).map(|depth| f64::from(*depth))
    }

    /// `None` outside the image.
    fn stand(&self, camera: &Camera, x: DVec3, reach: f64) -> Option<Stand> {
        let (at, depth) = camera.project_inside(x)?;
        // The nearest of the pixels that were looked at.
        let [start, stride] = [self.start, self.stride].map(i64::from);
        let middle = at.map(|v| (v as i64 - start + stride / 2).div_euclid(stride));
        let (mut nearest, mut farthest, mut count) = (f64::INFINITY, f64::NEG_INFINITY, 0);
        for depth in self.window([middle[0], middle[1]]) {
            (nearest, farthest, count) = (nearest.min(depth), farthest.max(depth), count + 1);
        }
        match () {
            () if count == 0 => Some(Stand::Masked),
            () if depth + reach < (1.0 - SLACK) * nearest => Some(Stand::Before),
            () if depth - reach <= (1.0 + SLACK) * farthest => Some(Stand::On),
            () => Some(Stand::Behind),
        }
    }
}

#[cfg(test)]
mod tests;
