//! The page: a histogram of deviations, and the least certain places with what would help there.

use std::path::Path;

use colorous::CIVIDIS;
use glam::DVec3;
use image::{Rgb, RgbImage};
use octobayes::Result;
use octobayes::error::counted;
use octobayes_depth::{NINETY, Trust};
use octobayes_show::depth_page::{DepthPage, Place};

use super::summary::{share_of_surface, shares};
use super::view::{DepthView, Quality};
use super::{Look, Unit};

/// Places that are shown, each of another photograph.
const PLACES: usize = 4;
/// Squares along the longest side of a photograph. The least certain of them is shown.
const SQUARES: usize = 26;
/// Half the side of a picture, squares.
const AROUND: usize = 4;
/// Classes of the histogram: from so many decades below one scene unit, and classes a decade.
const LOWEST: i32 = -6;
const CLASSES: usize = 8;
const DECADES: usize = 9;

/// Colours of the shares, in the order of [`Trust`].
const COLORS: [&str; Trust::ALL.len()] = ["#fff", "#444", "#b0413e", "#e0a030", "#4a8f5c"];

/// What the page is made of.
pub struct Page {
    unit: Unit,
    histogram: Vec<u64>,
    worst: Vec<Worst>,
}

/// The least certain square of a photograph.
struct Worst {
    /// Mean deviation over its trusted pixels, scene units.
    sigma: f64,
    position: DVec3,
    name: String,
    images: Vec<RgbImage>,
    /// Cameras that see a surface there, and the largest angle between two of them, degrees.
    views: usize,
    apart: f64,
}

impl Page {
    /// Nothing yet.
    pub fn new(unit: Unit) -> Self {
        Self { unit, histogram: vec![0; CLASSES * DECADES], worst: Vec::new() }
    }

    /// Counts a photograph.
    pub fn add(&mut self, view: &DepthView, look: &Look) {
        for (i, _) in view.trusted(look.surveyor.pixel_offset) {
            let class = (CLASSES as f64 * (view.sigma[i].log10() - f64::from(LOWEST))).floor();
            self.histogram[(class.max(0.0) as usize).min(CLASSES * DECADES - 1)] += 1;
        }
        let Some((sigma, middle)) = least_certain(view) else { return };
        if self.worst.len() == PLACES && self.worst.iter().all(|other| other.sigma >= sigma) {
            return;
        }
        let offset = look.surveyor.pixel_offset;
        let width = view.rendered.resolution[0] as usize;
        let [x, y] = [middle % width, middle / width].map(|n| n as f64 + offset);
        let position = view.camera.ray(x, y).at(view.rendered.pixels[middle].median_depth);
        let training = look.surveyor.training;
        let seeing: Vec<DVec3> = training
            .seeing(position)
            .filter(|(_, agrees)| *agrees)
            .map(|(i, _)| (training.camera(i).position - position).normalize())
            .collect();
        let pairs = seeing.iter().enumerate().flat_map(|(k, a)| seeing[k + 1..].iter().map(move |b| a.dot(*b)));
        let apart = pairs.fold(1.0_f64, f64::min).clamp(-1.0, 1.0).acos().to_degrees();
        let images = pictures(view, middle, look);
        self.worst.push(Worst { sigma, position, name: view.name.clone(), images, views: seeing.len(), apart });
        self.worst.sort_by(|a, b| b.sigma.total_cmp(&a.sigma));
        self.worst.truncate(PLACES);
    }

    /// Writes the page.
    pub fn write(&self, path: &Path, rows: &[Quality], title: &str, look: &Look) -> Result<()> {
        let unit = self.unit;
        let shares = shares(rows);
        let mut lead = Vec::new();
        if let Some(shares) = shares {
            lead.push(format!(
                "Of the surfaces in {}, {:.0} % have a depth on which three or more training cameras agree. The rest \
                 cannot be trusted, whatever their deviation says.",
                counted(rows.len(), "photograph"),
                100.0 * shares[Trust::Trusted as usize]
            ));
        }
        if let Some(median) = self.quantile(0.5).zip(self.quantile(0.95)) {
            let [half, most] = [median.0, median.1].map(|v| unit.length(NINETY * v));
            lead.push(format!(
                "Of the trusted depths, half are within ± {half}, and 95 % within ± {most}, with a probability of 90 %."
            ));
        }
        if !look.surveyor.deviation.has_images() {
            lead.push("The photographs themselves were not used: deviations follow from the model alone.".into());
        }
        if !unit.is_known {
            lead.push("The unit of the cameras is not known: all lengths are scene units.".into());
        }
        lead.extend(self.advice(shares));
        let table_head = ["photograph", "trusted", "never seen", "in front", "no agreement", "σ, median", "σ, 95 %"];
        let row = |row: &Quality| -> Vec<String> {
            let of = [Trust::Trusted, Trust::NeverSeen, Trust::InFront, Trust::NoAgreement];
            let percent = |share: Option<f64>| share.map_or(String::new(), |share| format!("{:.1} %", 100.0 * share));
            let sigma = |k: usize| row.sigma.map_or(String::new(), |sigma| unit.length(sigma[k] / unit.factor));
            let shares = of.map(|trust| percent(share_of_surface(row, trust)));
            [row.name.clone()].into_iter().chain(shares).chain([sigma(0), sigma(1)]).collect()
        };
        let place = |worst: &Worst| Place {
            text: format!(
                "{}: around {}, depths are uncertain by ± {} (90 %). {} photographs see the place, from directions at \
                 most {:.0}° apart.",
                worst.name,
                unit.place(worst.position),
                unit.length(NINETY * worst.sigma),
                worst.views,
                worst.apart
            ),
            images: worst.images.clone(),
        };
        let used: Vec<usize> = (0..self.histogram.len()).filter(|&k| self.histogram[k] > 0).collect();
        let range = used.first().copied().unwrap_or(0)..used.last().map_or(0, |last| last + 1);
        let page = DepthPage {
            title: title.rsplit(['/', '\\']).next().unwrap_or(title),
            lead,
            shares: shares.map_or(Vec::new(), |shares| {
                let named = Trust::ALL.iter().zip(shares).zip(COLORS).skip(1).rev();
                named.map(|((trust, share), color)| (trust.to_string(), share, color)).collect()
            }),
            unit: unit.name(),
            histogram: range.map(|k| (unit.factor * Self::low(k), self.histogram[k])).collect(),
            places: self.worst.iter().map(place).collect(),
            table: (table_head.map(String::from).to_vec(), rows.iter().map(row).collect()),
        };
        page.write(path)
    }

    /// A sentence on what to photograph.
    fn advice(&self, shares: Option<[f64; Trust::ALL.len()]>) -> Option<String> {
        let worst = self.worst.first()?;
        let unseen = shares.map_or(0.0, |shares| shares[Trust::NeverSeen as usize]);
        let side =
            if worst.apart < 30.0 { "from farther to the side, 30° or more from all that see it" } else { "closer" };
        let more = if unseen > 0.05 {
            format!(
                " {:.0} % of the surfaces are in one photograph only: overlapping views help there.",
                100.0 * unseen
            )
        } else {
            String::new()
        };
        let unit = self.unit;
        Some(format!(
            "To photograph next: the place around {} in {}, {side}.{more} The verb next-view chooses among cameras.",
            unit.place(worst.position),
            worst.name
        ))
    }

    /// The lower end of a class, scene units.
    fn low(class: usize) -> f64 {
        10_f64.powf(f64::from(LOWEST) + class as f64 / CLASSES as f64)
    }

    /// Deviation below which a share of the trusted pixels lies, to a class, scene units.
    fn quantile(&self, share: f64) -> Option<f64> {
        let all: u64 = self.histogram.iter().sum();
        let mut left = (share * all as f64) as u64;
        let class = self.histogram.iter().position(|count| {
            let is_here = left < *count;
            left = left.saturating_sub(*count);
            is_here
        });
        class.map(|class| Self::low(class) * 10_f64.powf(0.5 / CLASSES as f64))
    }
}

/// Pixels.
fn side_of_square(view: &DepthView) -> usize {
    let [width, height] = view.rendered.resolution;
    (width.max(height) as usize / SQUARES).max(4)
}

/// The least certain of the squares that are trusted for a half: its mean deviation, and its middle trusted pixel.
fn least_certain(view: &DepthView) -> Option<(f64, usize)> {
    let [width, height] = view.rendered.resolution.map(|n| n as usize);
    let side = side_of_square(view);
    let square = |[left, top]: [usize; 2]| {
        let rows = top..(top + side).min(height);
        let pixels = rows.flat_map(|y| (left..(left + side).min(width)).map(move |x| y * width + x));
        let trusted: Vec<usize> = pixels.filter(|&i| view.trust[i] == Trust::Trusted).collect();
        let mean = trusted.iter().map(|&i| view.sigma[i]).sum::<f64>() / trusted.len() as f64;
        (2 * trusted.len() >= side * side).then(|| (mean, trusted[trusted.len() / 2]))
    };
    let corners = (0..height).step_by(side).flat_map(|y| (0..width).step_by(side).map(move |x| [x, y]));
    corners.filter_map(square).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// The model's image around a pixel with its square, and the deviations there: dark is certain, yellow is not, and grey
/// cannot be trusted.
fn pictures(view: &DepthView, middle: usize, look: &Look) -> Vec<RgbImage> {
    let [width, height] = view.rendered.resolution.map(|n| n as usize);
    let (x, y) = (middle % width, middle / width);
    let half = side_of_square(view) / 2;
    let around = 2 * AROUND * half;
    let corner = |at: usize, n: usize| at.saturating_sub(around).min(n.saturating_sub(2 * around));
    let (left, top) = (corner(x, width), corner(y, height));
    let size = [(2 * around).min(width), (2 * around).min(height)].map(|n| n as u32);
    let mut known: Vec<f64> = view.trusted(look.surveyor.pixel_offset).map(|(i, _)| view.sigma[i]).collect();
    known.sort_unstable_by(f64::total_cmp);
    let most = octobayes::metrics::quantile(&known, 0.95);
    let index = |column: u32, row: u32| (top + row as usize) * width + left + column as usize;
    let color = |column: u32, row: u32| {
        let i = index(column, row);
        let [dx, dy] = [(left + column as usize).abs_diff(x), (top + row as usize).abs_diff(y)];
        if dx.max(dy) == half {
            return Rgb([230, 30, 30]);
        }
        Rgb(view.rendered.pixels[i].color.to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8))
    };
    let sigma = |column: u32, row: u32| {
        let i = index(column, row);
        match view.trust[i] {
            Trust::Trusted => Rgb(CIVIDIS.eval_continuous((view.sigma[i] / most).min(1.0)).as_array()),
            Trust::Transparent => Rgb([255; 3]),
            _ => Rgb([150; 3]),
        }
    };
    vec![RgbImage::from_fn(size[0], size[1], color), RgbImage::from_fn(size[0], size[1], sigma)]
}
