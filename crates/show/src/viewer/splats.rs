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
    view.page.text([packed.bounds, core], &Parts { scripts: &SCRIPTS, data: &data, about: about(view, packed) })
}

/// What the scripts of splats read.
fn about(view: &SplatsView, packed: &Packed) -> Value {
    let Codes { anchor, log_scales, color, log10 } = packed.codes;
    json!({
        "count": packed.count,
        "all": view.splats.len(),
        "isMip": view.splats.mode().is_compensated(),
        "dilation": view.splats.mode().dilation(),
        "drawn": { "near": NEAR, "beyond": FRUSTUM_MARGIN, "faintest": FAINTEST, "mostOpaque": MOST_OPAQUE, "dark": MIN_TRANSMITTANCE },
        "codes": { "anchor": anchor.to_array(), "logScales": log_scales, "color": color, "low": log10[0],
            "bytes": BYTES, "prior": PRIOR, "halfTurn": HALF_TURN },
    })
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use base64::Engine;
    use base64::prelude::BASE64_STANDARD;
    use flate2::read::ZlibDecoder;

    use super::*;
    use crate::viewer::page::tests::check;
    use octobayes::estimate::{Estimation, GridSettings, RaySettings};
    use octobayes::geometry::Camera;
    use octobayes::monitor::Silent;
    use octobayes_splats::{RenderMode, SplatRenderer};

    /// Numbers from 0 to 1 without a pattern.
    fn noise(i: usize, k: usize) -> f32 {
        (((i * 7919 + k * 104_729 + 12_345) * 2_654_435_761) % 100_003) as f32 / 100_003.0
    }

    /// Splats of many sizes, far from the origin.
    fn some(count: usize) -> Vec<Shown> {
        let shown = |i: usize| Shown {
            mean: Vec3::new(1000.0 + noise(i, 0), noise(i, 1), -noise(i, 2)),
            log_scales: -6.0 * Vec3::new(noise(i, 3), noise(i, 4), noise(i, 5)) - 1.0,
            rotation: Quat::from_xyzw(noise(i, 6) - 0.5, noise(i, 7) - 0.5, noise(i, 8) - 0.5, noise(i, 9) - 0.5)
                .normalize(),
            color: Vec3::new(noise(i, 10), noise(i, 11), 1.5 * noise(i, 12)),
            opacity: noise(i, 13),
            log10: 5.0 * f64::from(noise(i, 14)),
            is_unseen: noise(i, 15) > 0.5,
        };
        (0..count).map(shown).collect()
    }

    /// What scripts make of a splat's bytes.
    fn decoded(codes: &Codes, bytes: [u8; BYTES]) -> Shown {
        let word = |at: usize| [0, 1, 2, 3].map(|k| bytes[at + k]);
        let share = |at: usize| f32::from(bytes[at]) / 255.0;
        let [low, high] = codes.log_scales;
        let code = u32::from_le_bytes(word(15));
        let largest = (code >> 30) as usize;
        let mut q = [0.0; 4];
        for (place, k) in (0..4).filter(|&k| k != largest).enumerate() {
            let entry = (code >> (20 - 10 * place) & 1023) as f32;
            q[k] = (entry / HALF_TURN - 1.0) / std::f32::consts::SQRT_2;
        }
        q[largest] = (1.0 - q.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
        let [least, prior] = codes.log10;
        let log10 = f64::from(u16::from_le_bytes([bytes[23], bytes[24]]));
        Shown {
            mean: Vec3::from([0, 4, 8].map(|at| f32::from_le_bytes(word(at)))) + codes.anchor,
            log_scales: Vec3::from([12, 13, 14].map(|at| low + (high - low) * share(at))),
            rotation: Quat::from_array(q),
            color: codes.color * Vec3::from([19, 20, 21].map(share)),
            opacity: share(22),
            log10: least + (prior - least) * log10 / PRIOR,
            is_unseen: bytes[25] == 1,
        }
    }

    #[test]
    fn what_is_packed_comes_out_again_within_its_rounding() {
        let all = some(2000);
        let codes = Codes::of(&all, 5.5, Vec3::new(1000.5, 0.5, -0.5));
        let half_step = 0.5 * (codes.log_scales[1] - codes.log_scales[0]) / 255.0;
        assert!(half_step < 0.02, "scales are right within 2 %");
        for splat in &all {
            let found = decoded(&codes, codes.code(splat));
            // Two roundings of f32 numbers near 1000, which are 6e-5 apart.
            assert!((found.mean - splat.mean).abs().max_element() <= 6.2e-5, "{splat:?}");
            assert!((found.log_scales - splat.log_scales).abs().max_element() <= 1.01 * half_step, "{splat:?}");
            // Three entries off by half a step of 1 / (511 √2), and a largest entry of at least ½.
            assert!(found.rotation.angle_between(splat.rotation) < 5e-3, "{splat:?} {found:?}");
            assert!((found.color - splat.color).abs().max_element() <= 0.51 * codes.color / 255.0, "{splat:?}");
            assert!((found.opacity - splat.opacity).abs() <= 0.51 / 255.0, "{splat:?}");
            assert!((found.log10 - splat.log10).abs() <= 0.51 * 5.5 / PRIOR, "{splat:?}");
            assert_eq!(found.is_unseen, splat.is_unseen);
        }
        // Rotations without an angle have none.
        assert_eq!(decoded(&codes, codes.code(&Shown { rotation: Quat::IDENTITY, ..all[0] })).rotation, Quat::IDENTITY);
    }

    #[test]
    fn without_views_a_splat_matters_by_its_opacity_and_largest_section() {
        let log_scales =
            [Vec3::new(0.1, 4.0, 3.0), Vec3::splat(2.0)].map(|scale| Vec3::from(scale.to_array().map(f32::ln)));
        let (means, rotations) = (vec![Vec3::ZERO; 2], vec![Quat::IDENTITY; 2]);
        let splats =
            Splats::new(means, log_scales.to_vec(), rotations, vec![0.0, 40.0], vec![0.0; 6], 0, RenderMode::Classic);
        let splats = splats.unwrap();
        let found = importance(&splats, None);
        // ½ · 4 · 3 and 1 · 2 · 2.
        assert!((found[0] - 6.0).abs() < 1e-4 && (found[1] - 4.0).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn flat_splats_and_one_alone_have_finite_codes() {
        let flat = Shown { log_scales: Vec3::new(0.0, 0.0, -80.0), ..some(1)[0] };
        let codes = Codes::of(&[flat], 5.5, flat.mean);
        assert_eq!(codes.log_scales, [-LOG_RANGE, 0.0]);
        let round = Shown { log_scales: Vec3::ZERO, ..flat };
        let codes = Codes::of(&[round], 5.5, round.mean);
        assert!(decoded(&codes, codes.code(&round)).log_scales.abs().max_element() <= 1e-3);
    }

    /// Writes the viewer of 600 discs on a ball. Three cameras see one side of it.
    fn written(budget: usize) -> Result<(ShownSplats, String)> {
        let count = 600;
        let normal = |i: usize| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
            let (sin, cos) = (2.4 * i as f32).sin_cos();
            Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        };
        let splats = Splats::new(
            (0..count).map(normal).collect(),
            vec![Vec3::new(-2.8, -2.8, -5.0); count],
            (0..count).map(|i| Quat::from_rotation_arc(Vec3::Z, normal(i))).collect(),
            // Every sixth is too faint to be drawn.
            (0..count).map(|i| if i % 6 == 0 { -6.0 } else { 3.0 }).collect(),
            (0..3 * count).map(|k| noise(k, 0)).collect(),
            0,
            RenderMode::Classic,
        )?;
        let camera = |i: i32| {
            let (sin, cos) = (0.4 * f64::from(i)).sin_cos();
            Camera::look_at(3.0 * DVec3::new(cos, sin, 0.3), DVec3::ZERO, DVec3::Z, 0.9, [40; 2])
        };
        let cameras: Vec<Camera> = (0..3).map(camera).collect();
        let rays = RaySettings::default().rays(2000);
        let grid = GridSettings::default().level(4);
        let field = Estimation::new(&splats, &cameras).rays(rays).grid(grid).run()?.field;
        let renderer = SplatRenderer::new(&splats, Vec3::ONE);
        let seen = SeenSplats::measure(&renderer, &cameras, 0.5, u64::MAX, &Silent)?;
        let page = Page {
            field: &field,
            frames: &[],
            offset: 0.5,
            background: Vec3::ONE,
            surface: splats.means(),
            range: [2.0, field.prior().log10()],
            title: "a & <script>",
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.html");
        let shown = write_splats_view(&path, &SplatsView { splats: &splats, seen: Some(&seen), page }, budget)?;
        Ok((shown, std::fs::read_to_string(path).unwrap()))
    }

    fn element<'p>(page: &'p str, name: &str) -> &'p str {
        let (_, rest) = page.split_once(&format!("id=\"{name}\">")).unwrap();
        rest.split_once("</script>").unwrap().0
    }

    #[test]
    fn a_budget_is_kept_by_leaving_out_what_matters_least() {
        let (whole, page) = written(10_000_000).unwrap();
        assert_eq!((whole.count, whole.visible, whole.bytes), (500, 500, page.len()));
        assert!(whole.share == 1.0, "{whole:?}");
        check(&page);
        assert!(page.contains("<title>a &amp; &lt;script>"));
        let mut planes = Vec::new();
        let packed = BASE64_STANDARD.decode(element(&page, "planes")).unwrap();
        ZlibDecoder::new(&packed[..]).read_to_end(&mut planes).unwrap();
        assert_eq!(planes.len(), BYTES * whole.count);

        let budget = whole.bytes - 5000;
        let (less, page) = written(budget).unwrap();
        assert!(less.count < 500 && less.count > 200 && page.len() <= budget, "{less:?}");
        // More than half of the splats are on the side that hardly a pixel shows.
        assert!(less.share > 0.9, "{less:?}");
        // The scripts alone are larger.
        let error = written(10_000).unwrap_err().to_string();
        assert!(error.contains("size of the viewer") && error.contains("one splat"), "{error}");
    }
}
