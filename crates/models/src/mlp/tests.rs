//! A small random network compared with its layer-by-layer definition in f64, and damaged files.

use super::*;
use glam::DVec3;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use std::collections::BTreeMap;

/// Names and shapes of the fine network's tensors.
fn layout() -> Vec<(String, Vec<usize>)> {
    let layers = [
        ("layer1", 128, 63),
        ("layers_xyz.0", 128, 128),
        ("layers_xyz.1", 128, 128),
        ("layers_xyz.2", 128, 128),
        ("fc_alpha", 1, 128),
        ("fc_feat", 128, 128),
        ("layers_dir.0", 64, 155),
        ("fc_rgb", 3, 64),
    ];
    layers
        .iter()
        .flat_map(|(name, o, i)| {
            [(format!("fine.{name}.weight"), vec![*o, *i]), (format!("fine.{name}.bias"), vec![*o])]
        })
        .collect()
}

type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

fn random_network() -> Tensors {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let draw = |(name, shape): (String, Vec<usize>)| {
        let n: usize = shape.iter().product();
        // This scale keeps the size of activations through a layer.
        let scale = 3.0 / (*shape.last().unwrap() as f32).sqrt();
        (name, (shape, (0..n).map(|_| scale * rng.random_range(-1.0..1.0_f32)).collect()))
    };
    layout().into_iter().map(draw).collect()
}

fn write(tensors: &Tensors, path: &Path) {
    let bytes: BTreeMap<&String, Vec<u8>> =
        tensors.iter().map(|(name, (_, data))| (name, data.iter().flat_map(|v| v.to_le_bytes()).collect())).collect();
    let views = tensors
        .iter()
        .map(|(name, (shape, _))| (name, TensorView::new(Dtype::F32, shape.clone(), &bytes[name]).unwrap()));
    std::fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}

fn read(tensors: &Tensors) -> Result<NerfMlp> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    write(tensors, &path);
    NerfMlp::read(&path)
}

/// y = W x + b, written out.
fn layer(tensors: &Tensors, name: &str, x: &[f64]) -> Vec<f64> {
    let (shape, weight) = &tensors[&format!("fine.{name}.weight")];
    let bias = &tensors[&format!("fine.{name}.bias")].1;
    (0..shape[0])
        .map(|o| f64::from(bias[o]) + (0..shape[1]).map(|i| f64::from(weight[o * shape[1] + i]) * x[i]).sum::<f64>())
        .collect()
}

fn encode_slowly(v: DVec3, octaves: i32) -> Vec<f64> {
    let mut out = v.to_array().to_vec();
    for octave in 0..octaves {
        let angles = v * 2_f64.powi(octave);
        out.extend(angles.to_array().map(f64::sin));
        out.extend(angles.to_array().map(f64::cos));
    }
    out
}

/// The network's definition in f64, one sample at a time: density before its relu, and colour.
fn evaluate_slowly(tensors: &Tensors, position: DVec3, direction: Vec3) -> (f64, [f64; 3]) {
    let relu = |x: Vec<f64>| x.into_iter().map(|v| v.max(0.0)).collect::<Vec<_>>();
    let mut h = layer(tensors, "layer1", &encode_slowly(position, 10));
    for i in 0..3 {
        h = relu(layer(tensors, &format!("layers_xyz.{i}"), &h));
    }
    let density = layer(tensors, "fc_alpha", &h)[0];
    let mut joined = relu(layer(tensors, "fc_feat", &h));
    joined.extend(encode_slowly(direction.as_dvec3(), 4));
    let rgb = layer(tensors, "fc_rgb", &relu(layer(tensors, "layers_dir.0", &joined)));
    (density, [0, 1, 2].map(|c| 1.0 / (1.0 + (-rgb[c]).exp())))
}

fn samples(n: usize) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut draw = || Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.5..1.5_f32)));
    (0..n).map(|_| (draw(), draw().normalize())).unzip()
}

#[test]
fn batches_agree_with_the_definition() {
    let tensors = random_network();
    let model = read(&tensors).unwrap();
    let (positions, directions) = samples(300);
    let mut out = vec![Radiance::default(); 300];
    let mut densities = vec![0.0; 300];
    model.evaluate(&positions, &directions, &mut out);
    model.densities(&positions, &mut densities);
    for (i, found) in out.iter().enumerate() {
        let (density, color) = evaluate_slowly(&tensors, positions[i].as_dvec3(), directions[i]);
        // Five layers of at most 155 f32 products, on activations of the order of 1 to 10.
        assert!((f64::from(found.density) - density.max(0.0)).abs() < 2e-4, "{found:?} against {density}");
        assert_eq!(found.density, densities[i]);
        for c in 0..3 {
            assert!((f64::from(found.color[c]) - color[c]).abs() < 1e-4, "{found:?} against {color:?}");
        }
    }
    assert!(out.iter().filter(|r| r.density > 0.0).count() > 50, "the test looks at both sides of the relu");
}

#[test]
fn a_value_does_not_depend_on_its_batch() {
    let model = read(&random_network()).unwrap();
    let (positions, directions) = samples(300);
    let mut together = vec![Radiance::default(); 300];
    model.evaluate(&positions, &directions, &mut together);
    for size in [1, 2, 7, 100] {
        for (i, expected) in together.chunks(size).enumerate() {
            let range = i * size..i * size + expected.len();
            let mut alone = vec![Radiance::default(); expected.len()];
            model.evaluate(&positions[range.clone()], &directions[range], &mut alone);
            assert_eq!(alone, expected, "batch of {size}");
        }
    }
}

#[test]
fn encoding_is_the_definition() {
    let v = Vec3::new(0.3, -1.2, 0.05);
    let mut out = vec![0.0; ENCODED[0]];
    encode_block::<1>(&[v], OCTAVES[0], &mut out);
    let mut jets = vec![0.0; JET * ENCODED[0]];
    encode_block::<JET>(&[v], OCTAVES[0], &mut jets);
    assert_eq!(jets[..ENCODED[0]], out);
    for (i, expected) in encode_slowly(v.as_dvec3(), 10).into_iter().enumerate() {
        // Doubling is exact in f32; sine and cosine are good to 3e-7.
        assert!((f64::from(out[i]) - expected).abs() < 3e-7);
        for axis in 0..3 {
            let up = encode_slowly(v.as_dvec3() + 1e-3 * DVec3::AXES[axis], 10)[i];
            let down = encode_slowly(v.as_dvec3() - 1e-3 * DVec3::AXES[axis], 10)[i];
            let found = f64::from(jets[(axis + 1) * ENCODED[0] + i]);
            // Central differences of a sine of frequency f give sin(fh) / fh of its slope: up to 4 % too
            // little at f = 512.
            assert!((found - (up - down) / 2e-3).abs() <= 0.05 * found.abs() + 1e-3, "{i}, axis {axis}");
        }
    }
}

#[test]
fn jets_are_the_derivatives_of_the_definition() {
    let tensors = random_network();
    let model = read(&tensors).unwrap();
    let (positions, directions) = samples(150);
    let mut values = vec![Radiance::default(); 150];
    model.evaluate(&positions, &directions, &mut values);
    let mut jets = vec![RadianceJet::default(); 150];
    model.jets(&positions, &directions, &mut jets);
    let (mut densities, mut gradients) = (vec![0.0; 150], vec![Vec3::ZERO; 150]);
    model.density_jets(&positions, &mut densities, &mut gradients);
    let mut sharp = 0;
    for (i, jet) in jets.iter().enumerate() {
        assert_eq!((jet.value, jet.value.density), (values[i], densities[i]), "one arithmetic for all");
        assert_eq!(jet.density_gradient, gradients[i]);
        let (raw, _) = evaluate_slowly(&tensors, positions[i].as_dvec3(), directions[i]);
        for axis in 0..3 {
            let step = |side: f64| positions[i].as_dvec3() + side * 1e-7 * DVec3::AXES[axis];
            let slope = |up: f64, down: f64| {
                let [a, b] = [up, down].map(|side| evaluate_slowly(&tensors, step(side), directions[i]));
                ((a.0.max(0.0) - b.0.max(0.0)) / 1e-7, [0, 1, 2].map(|c| (a.1[c] - b.1[c]) / 1e-7))
            };
            let (up, down) = (slope(1.0, 0.0), slope(0.0, -1.0));
            // A ReLU between the two sides bends the line. Slopes sum terms up to 512 times those of values,
            // and f32 has them to 2e-4 of that.
            let check = |found: f32, up: f64, down: f64, scale: f64| {
                let off = (f64::from(found) - 0.5 * (up + down)).abs();
                assert!(off <= 0.6 * (up - down).abs() + 0.1 * scale, "{found}, not from {down} to {up}, axis {axis}");
            };
            check(jet.density_gradient[axis], up.0, down.0, 1.0);
            (0..3).for_each(|c| check(jet.color_gradients[axis][c], up.1[c], down.1[c], 0.25));
            sharp += usize::from(raw > 0.0 && (up.0 - down.0).abs() < 0.02 * up.0.abs() && up.0.abs() > 10.0);
        }
    }
    assert!(sharp > 30, "{sharp} slopes were looked at closely");
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    let message = |change: &dyn Fn(&mut Tensors)| {
        let mut tensors = random_network();
        change(&mut tensors);
        read(&tensors).unwrap_err().to_string()
    };
    let error = message(&|t| t.get_mut("fine.fc_feat.weight").unwrap().1[77] = f32::NAN);
    assert!(error.contains("fine.fc_feat.weight") && error.contains("element 77") && error.contains("NaN"), "{error}");
    let error = message(&|t| drop(t.remove("fine.fc_rgb.bias")));
    assert!(error.contains("fine.fc_rgb.bias") && error.contains("no such tensor"), "{error}");
    let error = message(&|t| {
        t.insert("fine.layer1.weight".into(), (vec![128, 39], vec![0.0; 128 * 39]));
    });
    assert!(error.contains("[128, 63]") && error.contains("[128, 39]") && error.contains("NDC"), "{error}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    std::fs::write(&path, [255; 64]).unwrap();
    let error = NerfMlp::read(&path).unwrap_err().to_string();
    assert!(error.contains("model.safetensors") && error.contains("safetensors file"), "{error}");
}
