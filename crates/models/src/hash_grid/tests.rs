use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::slow::{SMALL, SlowField, random_parameters};
use super::*;
use octobayes::field::RadianceJet;
use octobayes::geometry::Norm;

fn field(domain: Domain, rng: &mut ChaCha8Rng) -> HashGrid {
    field_with(0.2, domain, rng)
}

/// A random field with the given share of occupied cells.
fn field_with(share: f64, domain: Domain, rng: &mut ChaCha8Rng) -> HashGrid {
    let occupied = (0..512).map(|_| rng.random_bool(share)).collect();
    let training = serde_json::json!({ "seed": 7, "rate": 0.03_f32 });
    HashGrid::new(
        SMALL,
        Space::new(domain).unwrap(),
        random_parameters(|most| rng.random_range(-most..most)),
        occupied,
        training,
    )
}

fn domains() -> [Domain; 3] {
    let corners = [DVec3::new(-1.0, 0.5, -2.0), DVec3::new(2.0, 1.5, 0.0)];
    [
        Domain::Box(Aabb::new(corners[0], corners[1]).unwrap()),
        Domain::contracted(DVec3::new(0.5, 0.0, -1.0), 0.7, Norm::L2).unwrap(),
        Domain::contracted(DVec3::new(0.5, 0.0, -1.0), 0.7, Norm::Linf).unwrap(),
    ]
}

/// Positions all over the bounds, in contracted domains more of them near the middle.
fn positions(field: &HashGrid, rng: &mut ChaCha8Rng, count: usize) -> Vec<Vec3> {
    let (middle, half) = (0.5 * (field.bounds().min() + field.bounds().max()), 0.5 * field.bounds().size());
    let shrink = if field.domain().bounds().is_some() { [1.0, 1.0] } else { [0.05, 1.0] };
    (0..count)
        .map(|_| {
            let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            (middle + rng.random_range(shrink[0]..=shrink[1]) * v * half).as_vec3()
        })
        .collect()
}

fn directions(rng: &mut ChaCha8Rng, count: usize) -> Vec<Vec3> {
    (0..count).map(|_| Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0_f32))).normalize()).collect()
}

/// The window from its definition, in f64: trilinear between cell corners, 1 at corners of occupied cells.
fn window_slowly(occupied: &[bool], u: DVec3) -> f64 {
    let n = SMALL.occupancy as i64;
    let scaled = u * n as f64;
    let cell = scaled.to_array().map(|v| (v as i64).min(n - 1));
    let corner = |c: [i64; 3]| {
        (0..8).any(|k| {
            let [x, y, z] = [c[0] - (k & 1), c[1] - (k >> 1 & 1), c[2] - (k >> 2)];
            [x, y, z].iter().all(|i| (0..n).contains(i)) && occupied[((z * n + y) * n + x) as usize]
        })
    };
    (0..8_i64)
        .map(|k| {
            let up = [k & 1, k >> 1 & 1, k >> 2];
            let weight: f64 = (0..3)
                .map(|axis| {
                    let t = scaled[axis] - cell[axis] as f64;
                    if up[axis] == 1 { t } else { 1.0 - t }
                })
                .product();
            weight * f64::from(u8::from(corner(std::array::from_fn(|axis| cell[axis] + up[axis]))))
        })
        .sum()
}

/// σ in scene units and colour, in f64.
fn value_slowly(field: &HashGrid, x: DVec3, direction: Vec3) -> [f64; 4] {
    // Φ in f64, written out because `to_unit` takes f32.
    let u = match field.space.domain {
        Domain::Box(bounds) => (x - bounds.min()) / bounds.size(),
        Domain::Contracted { center, radius, norm } => {
            let y = (x - DVec3::from(center)) / radius;
            let r = if norm == Norm::L2 { y.length() } else { y.abs().max_element() };
            0.25 * (if r > 1.0 { (2.0 - 1.0 / r) / r * y } else { y } + 2.0)
        }
    };
    let value = SlowField::new(&field.parameters).value(u, direction);
    let scale = window_slowly(&field.occupied, u) / field.space.unit_length();
    [scale * value.sigma, value.color[0], value.color[1], value.color[2]]
}

#[test]
fn values_are_those_of_the_definition() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for domain in domains() {
        let field = field(domain, &mut rng);
        // Not a multiple of the block, so that a tail remains.
        let n = 3 * BLOCK + 7;
        let (positions, directions) = (positions(&field, &mut rng, n), directions(&mut rng, n));
        let (mut values, mut densities) = (vec![Radiance::default(); n], vec![-1.0; n]);
        field.evaluate(&positions, &directions, &mut values);
        field.densities(&positions, &mut densities);
        let mut dense = 0;
        for (((&x, &d), value), &density) in positions.iter().zip(&directions).zip(&values).zip(&densities) {
            let [sigma, r, g, b] = value_slowly(&field, x.as_dvec3(), d);
            // u is rounded to f32 (6e-8) in grids of up to 51 cells whose features are of order 1. Three
            // layers of 32 products and an exponential follow. 1e-4 relative to densities up to a few hundred
            // is ten times what is seen.
            assert!((f64::from(value.density) - sigma).abs() <= 1e-4 * sigma.max(0.1), "{x}: {value:?}, {sigma}");
            let color = DVec3::new(r, g, b);
            assert!((value.color.as_dvec3() - color).abs().max_element() < 1e-4, "{x}: {value:?}, {color}");
            assert_eq!(density, value.density);
            dense += usize::from(sigma > 0.1);
        }
        assert!(dense > n / 10, "{dense}");
        // A point gives the same value alone as in a batch.
        let mut alone = [Radiance::default()];
        field.evaluate(&positions[n - 1..], &directions[n - 1..], &mut alone);
        assert_eq!(alone[0], values[n - 1]);
    }
}

#[test]
fn outside_the_bounds_there_is_nothing() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for domain in domains() {
        let field = field(domain, &mut rng);
        let outside = [(field.bounds().max() + 0.01).as_vec3(), Vec3::splat(f32::MAX), Vec3::splat(-1e9)];
        let one = Radiance { density: 1.0, color: Vec3::ONE };
        let mut jets = [RadianceJet { value: one, density_gradient: Vec3::ONE, color_gradients: [Vec3::ONE; 3] }; 3];
        field.jets(&outside, &[Vec3::X; 3], &mut jets);
        let (mut densities, mut gradients) = ([1.0; 3], [Vec3::ONE; 3]);
        field.density_jets(&outside, &mut densities, &mut gradients);
        assert_eq!((densities, gradients), ([0.0; 3], [Vec3::ZERO; 3]));
        for jet in jets {
            assert!(jet.value.density == 0.0 && jet.value.is_valid(), "{jet:?}");
            assert_eq!(jet, RadianceJet { value: jet.value, ..RadianceJet::default() });
        }
    }
}

#[test]
fn position_gradients_are_those_of_the_definition() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for domain in domains() {
        let field = field(domain, &mut rng);
        let n = 150;
        let (positions, directions) = (positions(&field, &mut rng, n), directions(&mut rng, n));
        let mut jets = vec![RadianceJet::default(); n];
        field.jets(&positions, &directions, &mut jets);
        let mut plain = vec![Radiance::default(); n];
        field.evaluate(&positions, &directions, &mut plain);
        assert!(jets.iter().zip(&plain).all(|(jet, value)| jet.value == *value));
        let (mut densities, mut gradients) = (vec![-1.0; n], vec![Vec3::ONE; n]);
        field.density_jets(&positions, &mut densities, &mut gradients);
        assert!(jets.iter().zip(&densities).all(|(jet, density)| jet.value.density == *density));
        assert!(jets.iter().zip(&gradients).all(|(jet, gradient)| jet.density_gradient == *gradient));
        let (mut compared, mut kinks) = (0, 0);
        for ((&x, &d), found) in positions.iter().zip(&directions).zip(&jets) {
            // Gradients of density, red, green and blue.
            let of_channel = |c: usize| Vec3::from_array(found.color_gradients.map(|g| g[c]));
            let found = [found.density_gradient, of_channel(0), of_channel(1), of_channel(2)].map(Vec3::as_dvec3);
            for axis in 0..3 {
                let difference = |h: f64| {
                    let mut step = DVec3::ZERO;
                    step[axis] = h;
                    let [high, low] = [x.as_dvec3() + step, x.as_dvec3() - step].map(|x| value_slowly(&field, x, d));
                    std::array::from_fn::<f64, 4, _>(|k| (high[k] - low[k]) / (2.0 * h))
                };
                // Where the two steps disagree, there is a kink in between: a face of a cell, or a hidden
                // unit that switches.
                let (expected, coarse) = (difference(1e-6), difference(2e-6));
                for k in 0..4 {
                    let scale = expected[k].abs().max(1.0);
                    if (expected[k] - coarse[k]).abs() > 1e-4 * scale {
                        kinks += 1;
                        continue;
                    }
                    compared += 1;
                    // f32 sums of some hundred products, relative to gradients that are sums of larger terms.
                    let error = (expected[k] - found[k][axis]).abs();
                    assert!(error <= 2e-3 * scale, "{x} {k} {axis}: {} {}", expected[k], found[k][axis]);
                }
            }
        }
        assert!(compared > 1500 && kinks < 100, "{compared} {kinks}");
    }
}

#[test]
fn bounds_hold_and_empty_boxes_are_found() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for domain in domains() {
        let field = field_with(0.01, domain, &mut rng);
        let mut empty = 0;
        for x in positions(&field, &mut rng, 400) {
            let size = Vec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..0.1_f32)));
            let bound = field.density_bound(x, x + size);
            let inner: Vec<Vec3> =
                (0..50).map(|_| x + size * Vec3::from_array(std::array::from_fn(|_| rng.random()))).collect();
            let mut densities = [0.0; 50];
            field.densities(&inner, &mut densities);
            assert!(bound.is_none_or(|bound| densities.iter().all(|d| *d <= bound)), "{x} {size}");
            empty += usize::from(bound == Some(0.0));
        }
        assert!((10..390).contains(&empty), "{empty}");
    }
}

#[test]
fn files_keep_every_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let folder = tempfile::tempdir().unwrap();
    // Some JSON readers round the decimals of these corners differently.
    let awkward = Domain::Box(Aabb::centered_cube(0.5 / 0.33));
    for domain in domains().into_iter().chain([awkward]) {
        let field = field(domain, &mut rng);
        let [a, b] = ["a.safetensors", "b.safetensors"].map(|name| folder.path().join(name));
        field.write(&a).unwrap();
        assert!(HashGrid::is_in(&a).unwrap());
        let read = HashGrid::read(&a).unwrap();
        assert_eq!(read.parameters, field.parameters);
        assert_eq!((read.config, read.space, &read.occupied), (field.config, field.space, &field.occupied));
        assert_eq!(read.training(), field.training());
        read.write(&b).unwrap();
        assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&b).unwrap());
        let opened = crate::open(a.to_str().unwrap(), None).unwrap();
        assert_eq!(opened.describe(), field.describe());
        let positions = positions(&field, &mut rng, 100);
        let (mut before, mut after) = (vec![0.0; 100], vec![1.0; 100]);
        field.densities(&positions, &mut before);
        opened.densities(&positions, &mut after);
        assert_eq!(before, after);
    }
}

#[test]
fn damaged_files_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    let mut field = field(domains()[0], &mut rng);
    field.write(&path).unwrap();
    let good = std::fs::read(&path).unwrap();
    let all_of_space = Domain::contracted(DVec3::ZERO, 0.123, Norm::L2).unwrap();
    field_with(0.2, all_of_space, &mut rng).write(&path).unwrap();
    let contracted = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8], expected: &str| {
        std::fs::write(&path, bytes).unwrap();
        let error = HashGrid::read(&path).unwrap_err().to_string();
        assert!(error.contains("model.safetensors") && error.contains(expected), "{error}");
    };
    for length in [0, 7, 9, 100, good.len() / 2, good.len() - 1] {
        refused(&good[..length], "safetensors");
    }
    // Replaces words of the header by others of the same length.
    let altered_in = |good: &[u8], from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = good.windows(from.len()).position(|w| w == from.as_bytes()).unwrap_or_else(|| panic!("{from}"));
        [&good[..at], to.as_bytes(), &good[at + from.len()..]].concat()
    };
    let altered = |from: &str, to: &str| altered_in(&good, from, to);
    refused(&altered("octobayes_hash_grid", "octobayes_hash_gris"), "description of a hash grid");
    refused(&altered(r#"\"version\":1"#, r#"\"version\":2"#), "newer");
    refused(&altered(r#"\"n_neurons\":32"#, r#"\"n_neurons\":64"#), "64 neurons");
    refused(&altered(r#"\"occupancy\":8"#, r#"\"occupancy\":9"#), "multiple of 4");
    refused(&altered(r#"\"occupancy\":8"#, r#"\"occupancy\":4"#), "`occupancy`");
    refused(&altered(r#"\"log2_hashmap_size\":9"#, r#"\"log2_hashmap_size\":8"#), "encoding.");
    refused(&altered(r#"\"base_resolution\":3"#, r#"\"base_resolution\":0"#), "base_resolution");
    refused(&altered(r#"\"min\":[-1.0"#, r#"\"min\":[99.0"#), "min < max");
    // The radius is finite, but the bounds are not.
    refused(&altered_in(&contracted, r#"\"radius\":0.123"#, r#"\"radius\":1e308"#), "a possible model");
    refused(&altered("network.density0", "network.density7"), "no such tensor");
    field.parameters.network.color1[3][1] = f32::NAN;
    field.write(&path).unwrap();
    refused(&std::fs::read(&path).unwrap(), "network.color1`, element 13");
    std::fs::write(&path, b"no model at all").unwrap();
    assert!(!HashGrid::is_in(&path).unwrap());
}

#[test]
fn configurations_are_checked() {
    let base = HashGridConfig::default();
    assert!(base.checked().is_ok());
    for (config, what) in [
        (HashGridConfig { log2_hashmap_size: 7, ..base }, "log2_hashmap_size"),
        (HashGridConfig { log2_hashmap_size: 40, ..base }, "log2_hashmap_size"),
        (HashGridConfig { per_level_scale: f64::NAN, ..base }, "per_level_scale"),
        (HashGridConfig { per_level_scale: 0.5, ..base }, "per_level_scale"),
        (HashGridConfig { base_resolution: u32::MAX, ..base }, "base_resolution"),
        (HashGridConfig { occupancy: 132, ..base }, "occupancy"),
        (HashGridConfig { occupancy: 0, ..base }, "occupancy"),
    ] {
        assert!(config.checked().unwrap_err().to_string().contains(what), "{config:?}");
    }
    assert_eq!(base.resolutions()[0], 16);
}

#[test]
fn removed_cells_are_empty_and_the_others_stay() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for domain in domains() {
        let whole = field(domain, &mut rng);
        let (coarse, n) = (SMALL.occupancy, whole.finest_occupancy());
        assert_eq!((coarse, n), (8, 128));
        // One half of the cells along x.
        let removed: Vec<bool> = (0..n.pow(3)).map(|cell| cell % n < n / 2).collect();
        let left = whole.without(&removed);
        let points = positions(&whole, &mut rng, 4000);
        let densities = |field: &HashGrid| {
            let mut densities = vec![0.0; points.len()];
            field.densities(&points, &mut densities);
            densities
        };
        let mut counts = [0; 2];
        for ((x, before), after) in points.iter().zip(densities(&whole)).zip(densities(&left)) {
            let Some(u) = whole.space().unit(*x) else { continue };
            // The window of smaller cells falls faster: nothing is denser than before.
            assert!(after <= before, "{x}: {before}, {after}");
            let past = u[0] * n as f32 - (n / 2) as f32;
            let [i, j, k] = u.map(|v| (v * coarse as f32) as usize);
            if past < -1.0 {
                assert_eq!(after, 0.0, "{x}");
                counts[0] += usize::from(before > 0.0);
            } else if past > 0.0 && whole.occupied()[(k * coarse + j) * coarse + i] {
                assert_eq!(after, before, "{x}");
                counts[1] += 1;
            }
        }
        assert!(counts.iter().all(|count| *count > 100), "{counts:?}");
        // Nothing changes without a removal. A single cell lies between others, and the window does not fall there.
        let none = vec![false; n.pow(3)];
        assert_eq!(densities(&whole.without(&none)), densities(&whole));
        let full = field_with(1.0, domain, &mut rng);
        let one: Vec<bool> = (0..n.pow(3)).map(|cell| cell == n.pow(3) / 2 + n * n / 2 + n / 2).collect();
        assert_eq!(densities(&full.without(&one)), densities(&full));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("left.safetensors");
        left.write(&path).unwrap();
        assert_eq!(HashGrid::read(&path).unwrap().occupied(), left.occupied());
    }
}
