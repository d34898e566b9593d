//! Writes the page of splats: as many as fit into the file, at 26 bytes each.
//!
//! Splats are drawn as `render` draws them, so all that is lost is what the rounding of their parameters takes, and the
//! dependence of colour on direction.

use std::path::Path;

use glam::{DVec3, Quat, Vec3};
use serde_json::{Value, json};

use super::pack::text;
use super::page::{Page, Parts, write};
use octobayes::geometry::Aabb;
use octobayes::uncertainty::Observability;
use octobayes::{Error, Result};
use octobayes_splats::{FAINTEST, FRUSTUM_MARGIN, MIN_TRANSMITTANCE, MOST_OPAQUE, NEAR, SeenSplats, Splats};

const SCRIPTS: [&str; 2] = [include_str!("web/splats.js"), include_str!("web/splats-renderer.js")];
const SHADERS: [(&str, &str); 3] = [
    ("splats-vertex", include_str!("web/splats.vert.glsl")),
    ("splats-fragment", include_str!("web/splats.frag.glsl")),
    ("splats-resolve", include_str!("web/splats.resolve.glsl")),
];
/// Bytes of a splat, before they are compressed.
const BYTES: usize = 26;
/// Logarithms of scales have this range at most, from the largest down. An axis a ten-millionth as long as the largest
/// is flat.
const LOG_RANGE: f32 = 16.0;
/// Brightest colour that is stored.
const BRIGHTEST: f32 = 2.0;
/// Codes of log10 U run from 0 at the lower end to this at the prior.
const PRIOR: f64 = 65_535.0;
/// Steps of a rotation's entries at either side of 0.
const HALF_TURN: f32 = 511.0;

/// What a file shows of splats.
pub struct SplatsView<'a> {
    /// The model.
    pub splats: &'a Splats,
    /// What the training views show of it, if they are at hand.
    pub seen: Option<&'a SeenSplats>,
    /// What is shown beside it.
    pub page: Page<'a>,
}

/// What was written.
#[derive(Debug, Clone, Copy)]
pub struct ShownSplats {
    /// Splats in the file.
    pub count: usize,
    /// Splats that pictures can show: of opacity 1/255 or more.
    pub visible: usize,
    /// Share of [`SplatsView::splats`]' importance that the file has, 0 to 1.
    pub share: f64,
    /// Bytes of the file.
    pub bytes: usize,
}

/// Writes the viewer with as many splats as fit into `budget` bytes: those that matter most.
///
/// # Errors
/// If the file cannot be written, if no splat can be seen, or if not even one fits.
pub fn write_splats_view(path: &Path, view: &SplatsView, budget: usize) -> Result<ShownSplats> {
    let splats = view.splats;
    let importance = importance(splats, view.seen);
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| f64::from(splats.opacity(i)) >= FAINTEST).collect();
    order.sort_by(|&a, &b| importance[b].total_cmp(&importance[a]));
    let visible = order.len();
    if visible == 0 {
        return Err(Error::setting(
            "splats",
            "one whose opacity is at least 1/255",
            format!("none of {}", splats.len()),
        ));
    }
    let total: f64 = order.iter().map(|&i| importance[i]).sum();
    loop {
        let packed = Packed::new(view, &order)?;
        let page = page(view, &packed);
        if page.len() <= budget {
            write(path, &page)?;
            let kept: f64 = order.iter().map(|&i| importance[i]).sum();
            let share = if total > 0.0 { kept / total } else { 1.0 };
            return Ok(ShownSplats { count: order.len(), visible, share, bytes: page.len() });
        }
        let room = budget.saturating_sub(page.len() - packed.planes.len()) as f64 / packed.planes.len() as f64;
        let fewer = (0.99 * room * order.len() as f64) as usize;
        if fewer == 0 {
            let expected = format!("at least {} bytes, for one splat", page.len() - packed.planes.len());
            return Err(Error::setting("size of the viewer", expected, format!("{budget}")));
        }
        order.truncate(fewer);
    }
}

/// `[n]`: how much of the training pixels each splat makes up; without views, its opacity times the area of its largest
/// section.
fn importance(splats: &Splats, seen: Option<&SeenSplats>) -> Vec<f64> {
    let area = |i: usize| {
        let scale = splats.scale(i);
        f64::from(splats.opacity(i)) * f64::from(scale.element_product()) / f64::from(scale.min_element())
    };
    seen.map_or_else(|| (0..splats.len()).map(area).collect(), |seen| seen.weights.clone())
}

/// How numbers become codes.
#[derive(Debug, Clone, Copy)]
struct Codes {
    /// Positions are stored relative to this: f32 then resolves scenes that are far from their origin.
    anchor: Vec3,
    /// Logarithms of scales of code 0 and 255.
    log_scales: [f32; 2],
    /// Colour of code 255.
    color: f32,
    /// log10 U of code 0 and of [`PRIOR`].
    log10: [f64; 2],
}

/// A splat as it is shown.
#[derive(Debug, Clone, Copy)]
struct Shown {
    mean: Vec3,
    log_scales: Vec3,
    rotation: Quat,
    color: Vec3,
    opacity: f32,
    log10: f64,
    is_unseen: bool,
}

impl Codes {
    /// Those that hold all of `shown`.
    fn of(shown: &[Shown], prior: f64, anchor: Vec3) -> Self {
        let largest = shown.iter().map(|splat| splat.log_scales.max_element()).fold(f32::MIN, f32::max);
        let smallest = shown.iter().map(|splat| splat.log_scales.min_element()).fold(f32::MAX, f32::min);
        let brightest = shown.iter().map(|splat| splat.color.max_element()).fold(1.0, f32::max);
        let low = shown.iter().map(|splat| splat.log10).fold(prior - 1.0, f64::min);
        Self {
            anchor,
            log_scales: [smallest.max(largest - LOG_RANGE).min(largest - 1e-3), largest],
            color: brightest.min(BRIGHTEST),
            log10: [low, prior],
        }
    }

    /// The bytes of a splat: mean (12), scales (3), rotation (4), colour (3), opacity, log10 U (2), never seen.
    fn code(&self, splat: &Shown) -> [u8; BYTES] {
        let byte = |share: f32| (255.0 * share.clamp(0.0, 1.0)).round() as u8;
        let [low, high] = self.log_scales;
        let [least, prior] = self.log10;
        let log10 = (PRIOR * ((splat.log10 - least) / (prior - least)).clamp(0.0, 1.0)).round() as u16;
        let mean = (splat.mean - self.anchor).to_array().into_iter().flat_map(f32::to_le_bytes);
        let scales = splat.log_scales.to_array().map(|log| byte((log - low) / (high - low)));
        let color = splat.color.to_array().map(|channel| byte(channel / self.color));
        let all = mean
            .chain(scales)
            .chain(rotation_code(splat.rotation).to_le_bytes())
            .chain(color)
            .chain([byte(splat.opacity)])
            .chain(log10.to_le_bytes())
            .chain([u8::from(splat.is_unseen)]);
        let mut code = [0; BYTES];
        code.iter_mut().zip(all).for_each(|(code, byte)| *code = byte);
        code
    }
}

/// Three entries of a unit quaternion in ten bits each, all but the largest; above them, which it is. Its sign is made
/// positive, because q and −q are one rotation.
fn rotation_code(rotation: Quat) -> u32 {
    let q = rotation.normalize().to_array();
    let largest = (0..4).fold(0, |best, k| if q[k].abs() > q[best].abs() { k } else { best });
    let sign = q[largest].signum();
    let entry = |k: usize| (HALF_TURN * (1.0 + sign * q[k] * std::f32::consts::SQRT_2)).round() as u32;
    (0..4).filter(|&k| k != largest).fold(largest as u32, |code, k| code << 10 | entry(k).min(1023))
}

/// Splats, compressed.
struct Packed {
    codes: Codes,
    count: usize,
    /// The box of the centres.
    bounds: Aabb,
    /// `[BYTES][count]`: the first byte of all splats, then the second, and so on: alike ones side by side compress
    /// well. Base 64 of zlib.
    planes: String,
}

impl Packed {
    /// Packs the splats `chosen`.
    fn new(view: &SplatsView, chosen: &[usize]) -> Result<Self> {
        let shown = shown(view, chosen);
        let bounds = |of: fn(Vec3, Vec3) -> Vec3| shown.iter().map(|splat| splat.mean).reduce(of).unwrap_or_default();
        let [low, high] = [bounds(Vec3::min), bounds(Vec3::max)].map(Vec3::as_dvec3);
        // Not flat, even if there is one splat.
        let margin = DVec3::splat(1e-6 * (high - low).max_element().max(high.abs().max_element()).max(1e-30));
        let bounds = Aabb::new(low - margin, high + margin)?;
        let anchor = (0.5 * (bounds.min() + bounds.max())).as_vec3();
        let codes = Codes::of(&shown, view.page.field.prior().log10(), anchor);
        let rows: Vec<[u8; BYTES]> = shown.iter().map(|splat| codes.code(splat)).collect();
        let planes: Vec<u8> = (0..BYTES).flat_map(|k| rows.iter().map(move |row| row[k])).collect();
        Ok(Self { codes, count: chosen.len(), bounds, planes: text(&planes) })
    }
}

/// What is shown of the splats `chosen`.
fn shown(view: &SplatsView, chosen: &[usize]) -> Vec<Shown> {
    let splats = view.splats;
    let means: Vec<Vec3> = chosen.iter().map(|&i| splats.mean(i)).collect();
    let found = view.page.field.answers(&means);
    let seen_color = |i: usize| view.seen.and_then(|seen| seen.colors[i]);
    let shown = |(&i, found): (&usize, octobayes::uncertainty::Answer)| Shown {
        mean: splats.mean(i),
        log_scales: splats.log_scales()[i],
        rotation: splats.rotation(i),
        color: seen_color(i).unwrap_or_else(|| splats.constant_color(i)),
        opacity: splats.opacity(i),
        log10: found.estimate.uncertainty.log10(),
        is_unseen: found.observability == Some(Observability::Unseen),
    };
    chosen.iter().zip(found).map(shown).collect()
}

/// The page as text.
fn page(view: &SplatsView, packed: &Packed) -> String {
    let data = [&SHADERS[..], &[("planes", packed.planes.as_str())]].concat();
    // Some of a trained scene always lie far from all others: what is looked at is the rest.
    let core = view.splats.main_box();
    let about = about(view, packed);
    view.page.text([packed.bounds, core], &Parts { scripts: &SCRIPTS, data: &data, about, is_volume: false })
}

/// What the scripts of splats read.
fn about(view: &SplatsView, packed: &Packed) -> Value {
    let Codes { anchor, log_scales, color, log10 } = packed.codes;
    json!({
        "count": packed.count,
        "all": view.splats.len(),
        "isMip": view.splats.mode().is_compensated(),
        "dilation": view.splats.mode().dilation(),
        "drawn": { "near": NEAR, "beyond": FRUSTUM_MARGIN, "faintest": FAINTEST, "mostOpaque": MOST_OPAQUE,
            "dark": MIN_TRANSMITTANCE },
        "codes": { "anchor": anchor.to_array(), "logScales": log_scales, "color": color, "low": log10[0],
            "bytes": BYTES, "prior": PRIOR, "halfTurn": HALF_TURN },
    })
}

#[cfg(test)]
mod tests;
