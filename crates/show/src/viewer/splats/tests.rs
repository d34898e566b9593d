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
        planned: &[],
        offset: 0.5,
        background: Vec3::ONE,
        surface: splats.means(),
        range: [2.0, field.prior().log10()],
        title: "a & <script>",
        unit: (1.0, "scene units"),
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
