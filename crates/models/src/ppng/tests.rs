//! Small random models compared with the definition in f64, in both coordinates, and damaged files.

use std::f64::consts::PI;

use half::f16;
use minicbor::Encoder;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::*;
use octobayes::estimate::RaySettings;
use octobayes::monitor::Silent;
use octobayes::render::render_view;

/// The content of a file before it is encoded.
#[derive(Clone)]
struct Model {
    kind: u64,
    quants: usize,
    rank: usize,
    freqs: [f64; 4],
    cells: u64,
    runs: Vec<Vec<u32>>,
    /// As in the file; exact in f16.
    tables: Vec<f32>,
    layers: [Vec<f32>; 3],
    poses: Vec<[[f64; 4]; 3]>,
}

/// Number of entries of the map.
const KEYS: u64 = 16;

/// A change that makes a model wrong.
type Change<'a> = &'a dyn Fn(&mut Model);

impl Model {
    /// A model of random numbers with every cell occupied.
    fn random(kind: u64, quants: usize, rank: usize, cascades: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(kind);
        let points = if kind == 1 { quants } else { quants * quants };
        let tables =
            (0..3 * 8 * points * rank * 4).map(|_| f16::from_f32(rng.random_range(-2.0..2.0)).to_f32()).collect();
        let layers = [512, 512, 64].map(|n| (0..n).map(|_| rng.random_range(-0.5..0.5_f32)).collect());
        Self {
            kind,
            quants,
            rank,
            freqs: [1.0, 2.0, 4.0, 8.0],
            cells: 8,
            runs: vec![vec![0, 512]; cascades],
            tables,
            layers,
            // Rows of a camera in front of the box: right x, down −y, forward −z.
            poses: vec![[[1.0, 0.0, 0.0, 0.4], [0.0, -1.0, 0.0, 0.6], [0.0, 0.0, -1.0, 2.5]]],
        }
    }

    fn bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut e = Encoder::new(&mut out);
        e.map(KEYS).unwrap();
        e.str("freqs").unwrap().array(4).unwrap();
        for f in self.freqs {
            e.f64(f).unwrap();
        }
        let integers = [
            ("qff_type", self.kind),
            ("n_freqs", 4),
            ("n_feats", 4),
            ("n_quants", self.quants as u64),
            ("rank", self.rank as u64),
            ("grid_res", self.cells),
            ("grid_mip", self.runs.len() as u64),
            ("grid_thres", 1),
        ];
        for (key, value) in integers {
            e.str(key).unwrap().u64(value).unwrap();
        }
        e.str("grid_rles").unwrap().array(self.runs.len() as u64).unwrap();
        for runs in &self.runs {
            e.array(runs.len() as u64).unwrap();
            for &run in runs {
                e.u32(run).unwrap();
            }
        }
        e.str("poses").unwrap().begin_array().unwrap();
        for rows in &self.poses {
            e.array(3).unwrap();
            for row in rows {
                e.array(4).unwrap();
                for v in row {
                    e.f32(*v as f32).unwrap();
                }
            }
        }
        e.end().unwrap();
        e.str("render_step").unwrap().f64(0.01).unwrap();
        let tables: Vec<u8> = self.tables.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        e.str("qff_buffer").unwrap().bytes(&tables).unwrap();
        for (key, layer) in ["qff_density_layer_0", "qff_color_layer_0", "qff_color_layer_1"].iter().zip(&self.layers) {
            let bytes: Vec<u8> = layer.iter().flat_map(|v| v.to_le_bytes()).collect();
            e.str(key).unwrap().bytes(&bytes).unwrap();
        }
        out
    }

    fn parse(&self, coordinates: Coordinates) -> Result<Ppng> {
        parse(&self.bytes()).map(|file| Ppng::new(file, coordinates))
    }

    fn field(&self, coordinates: Coordinates) -> Ppng {
        self.parse(coordinates).unwrap()
    }

    /// The published definition: σ per file unit and colour at file position `p`, in f64, with numbers taken
    /// from the file's layout.
    fn reference(&self, p: DVec3, v: DVec3) -> (f64, [f64; 3]) {
        let (quants, rank) = (self.quants, self.rank);
        let q = (p - 0.5) / f64::from(1_u32 << (self.runs.len() - 1)) + 0.5;
        let mut features = Vec::new();
        for slot in 0..8 {
            let place = |axis: usize| {
                let a = self.freqs[slot / 2] * PI * (q[axis] - 0.5);
                let s = if slot % 2 == 0 { a.sin() } else { a.cos() };
                let u = (s + 1.0) / 2.0 * (quants - 1) as f64;
                let i = (u.floor() as usize).min(quants - 2);
                [(i, 1.0 - (u - i as f64)), (i + 1, u - i as f64)]
            };
            let [x, y, z] = [0, 1, 2].map(place);
            let at = |table: usize, point: usize, r: usize, c: usize| {
                let points = if self.kind == 1 { quants } else { quants * quants };
                f64::from(self.tables[(((table * 8 + slot) * points + point) * rank + r) * 4 + c])
            };
            for c in 0..4 {
                let mut sum = 0.0;
                for r in 0..rank {
                    if self.kind == 1 {
                        let line = |table: usize, u: [(usize, f64); 2]| {
                            u.map(|(i, w)| w * at(table, i, r, c)).iter().sum::<f64>()
                        };
                        sum += line(0, x) * line(1, y) * line(2, z);
                    } else {
                        for ((x, wx), (y, wy), (z, wz)) in
                            (0..8).map(|corner| (x[corner & 1], y[corner >> 1 & 1], z[corner >> 2]))
                        {
                            let volume =
                                at(0, z * quants + y, r, c) * at(1, z * quants + x, r, c) * at(2, y * quants + x, r, c);
                            sum += wx * wy * wz * volume;
                        }
                    }
                }
                features.push(sum);
            }
        }
        let layer = |a: &[f32], out: usize, x: &[f64]| -> Vec<f64> {
            let mut y = vec![0.0; out];
            for (ib, x) in x.chunks(4).enumerate() {
                for (ob, y) in y.chunks_mut(4).enumerate() {
                    for (r, y) in y.iter_mut().enumerate() {
                        *y += (0..4).map(|c| f64::from(a[(ib * (out / 4) + ob) * 16 + 4 * r + c]) * x[c]).sum::<f64>();
                    }
                }
            }
            y
        };
        let mut h = layer(&self.layers[0], 16, &features);
        let sigma = h[0].min(11.0).exp();
        let (x, y, z) = (v.x, v.y, v.z);
        let r = f64::sqrt;
        let harmonics = [
            1.0,
            -r(3.0) * y,
            r(3.0) * z,
            -r(3.0) * x,
            r(15.0) * x * y,
            -r(15.0) * y * z,
            r(5.0) / 2.0 * (3.0 * z * z - 1.0),
            -r(15.0) * x * z,
            r(15.0) / 2.0 * (x * x - y * y),
            r(70.0) / 4.0 * y * (y * y - 3.0 * x * x),
            r(105.0) * x * y * z,
            r(42.0) / 4.0 * y * (1.0 - 5.0 * z * z),
            r(7.0) / 2.0 * z * (5.0 * z * z - 3.0),
            r(42.0) / 4.0 * x * (1.0 - 5.0 * z * z),
            r(105.0) / 2.0 * z * (x * x - y * y),
            r(70.0) / 4.0 * x * (3.0 * y * y - x * x),
        ];
        h.extend(harmonics.map(|v| v / (2.0 * PI.sqrt())));
        let hidden: Vec<f64> = layer(&self.layers[1], 16, &h).into_iter().map(|v| v.max(0.0)).collect();
        let output = layer(&self.layers[2], 4, &hidden);
        (sigma, [0, 1, 2].map(|c| 1.0 / (1.0 + (-output[c]).exp())))
    }
}

fn parse(bytes: &[u8]) -> Result<File> {
    File::parse(Path::new("model.ppng"), bytes)
}

/// Positions in the cube of the given side around ½, and unit directions.
fn samples(n: usize, side: f32) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut draw = || Vec3::from_array(std::array::from_fn(|_| rng.random_range(-0.5..0.5_f32)));
    (0..n).map(|_| (side * draw() + 0.5, draw().normalize())).unzip()
}

fn evaluate(field: &Ppng, positions: &[Vec3], directions: &[Vec3]) -> Vec<Radiance> {
    let mut out = vec![Radiance::default(); positions.len()];
    field.evaluate(positions, directions, &mut out);
    out
}

#[test]
fn batches_agree_with_the_definition() {
    // Odd and even ranks, one cascade and two.
    for (kind, rank, cascades) in [(1, 3, 1), (1, 8, 2), (2, 2, 1), (2, 1, 2)] {
        let model = Model::random(kind, 7, rank, cascades);
        let field = model.field(Coordinates::Ngp);
        let (positions, directions) = samples(300, cascades as f32);
        let out = evaluate(&field, &positions, &directions);
        let mut densities = vec![0.0; 300];
        field.densities(&positions, &mut densities);
        let mut spread = [f64::INFINITY, f64::NEG_INFINITY];
        for (i, found) in out.iter().enumerate() {
            let (sigma, color) = model.reference(positions[i].as_dvec3(), directions[i].as_dvec3());
            // Table coordinates, 3 (1 + sin), are off by 3 (π·4·2⁻²⁴ + 2e-7) = 3e-6. A feature of numbers up
            // to 2 changes by up to 48 R per unit, and 32 of them enter log σ with weights below ½. Random
            // signs leave 1e-5 of it (the largest seen).
            let error = f64::from(found.density).ln() - sigma.ln();
            assert!(error.abs() < 5e-5, "type {kind}, rank {rank}: {found:?}, expected {sigma}");
            for c in 0..3 {
                assert!((f64::from(found.color[c]) - color[c]).abs() < 5e-5, "{found:?}, expected {color:?}");
            }
            assert_eq!(found.density, densities[i]);
            spread = [spread[0].min(sigma), spread[1].max(sigma)];
        }
        assert!(spread[1] > 100.0 * spread[0], "the test looks at different densities: {spread:?}");
    }
}

#[test]
fn jets_are_the_derivatives_of_the_definition() {
    // Some cells are empty, so that the window has ramps.
    for (kind, rank, coordinates) in
        [(1, 3, Coordinates::Ngp), (1, 8, Coordinates::Blender), (2, 2, Coordinates::Ngp), (2, 1, Coordinates::Blender)]
    {
        let mut model = Model::random(kind, 7, rank, 1);
        model.runs = vec![vec![100, 30, 70, 200, 112]];
        let field = model.field(coordinates);
        let (positions, directions) = samples(2000, 1.0);
        let (scale, center) = (coordinates.scale(), if coordinates == Coordinates::Ngp { 0.0 } else { 0.5 });
        let positions: Vec<Vec3> = positions.iter().map(|x| ((x - center).as_dvec3() / scale).as_vec3()).collect();
        let mut jets = vec![RadianceJet::default(); 2000];
        field.jets(&positions, &directions, &mut jets);
        let (mut densities, mut gradients) = (vec![0.0; 2000], vec![Vec3::ZERO; 2000]);
        field.density_jets(&positions, &mut densities, &mut gradients);
        let values = evaluate(&field, &positions, &directions);
        let (mut compared, mut ramps) = (0, 0);
        for (i, jet) in jets.iter().enumerate() {
            assert_eq!((jet.value, jet.value.density), (values[i], densities[i]), "one arithmetic for all");
            assert_eq!(jet.density_gradient, gradients[i]);
            // The definition in f64 times the field's own window, by the product rule.
            let (w, ramp) = field.window.at_with_gradient(coordinates.centered(positions[i]));
            let ramp = coordinates.gradient(ramp.to_array()).map(f64::from);
            let at = |x: DVec3| {
                let (c, d) = if coordinates == Coordinates::Ngp {
                    (x - 0.5, directions[i].as_dvec3())
                } else {
                    (0.33 * DVec3::new(x.y, x.z, x.x), coordinates.direction(directions[i]).as_dvec3())
                };
                let (sigma, color) = model.reference(c + 0.5, d);
                (scale * sigma, DVec3::from(color))
            };
            let x = positions[i].as_dvec3();
            let (sigma, color) = at(x);
            for (axis, along) in ramp.into_iter().enumerate() {
                let slope = |side: f64| {
                    let (density, c) = at(x + side * 1e-6 * DVec3::AXES[axis]);
                    (f64::from(w) * (density - sigma) / (side * 1e-6) + along * sigma, (c - color) / (side * 1e-6))
                };
                // At a kink of the tables or a ReLU, any slope between the two sides will do. f32 has the
                // value to 5e-5, as above, and the slope, a sum of a hundred times larger terms, to a hundred
                // times that.
                let (up, down) = (slope(1.0), slope(-1.0));
                let found = f64::from(jet.density_gradient[axis]);
                let off = (found - 0.5 * (up.0 + down.0)).abs();
                let limit = 0.6 * (up.0 - down.0).abs() + 5e-3 * scale * sigma;
                assert!(off <= limit, "{found}, not from {} to {}, axis {axis} at {x}", down.0, up.0);
                let found = jet.color_gradients[axis].as_dvec3();
                let off = (found - 0.5 * (up.1 + down.1)).length();
                assert!(
                    off <= 0.6 * (up.1 - down.1).length() + 5e-3 * scale,
                    "{found}, not from {} to {}",
                    down.1,
                    up.1
                );
                // Counts only comparisons with a tight limit.
                let sharp = limit < 0.01 * up.0.abs();
                compared += usize::from(sharp && w == 1.0);
                ramps += usize::from(sharp && w > 0.0 && w < 1.0);
            }
        }
        assert!(compared > 200 && ramps > 20, "{compared} {ramps}");
    }
}

#[test]
fn a_value_does_not_depend_on_its_batch() {
    let mut model = Model::random(1, 7, 8, 1);
    model.runs = vec![vec![100, 30, 70, 200, 112]];
    let field = model.field(Coordinates::Ngp);
    let (positions, directions) = samples(300, 1.1);
    let together = evaluate(&field, &positions, &directions);
    for size in [1, 2, 7, 64, 100] {
        for (i, expected) in together.chunks(size).enumerate() {
            let range = i * size..i * size + expected.len();
            assert_eq!(
                evaluate(&field, &positions[range.clone()], &directions[range.clone()]),
                expected,
                "batch of {size}"
            );
            let mut densities = vec![-1.0; expected.len()];
            field.densities(&positions[range], &mut densities);
            assert!(densities.iter().zip(expected).all(|(d, e)| *d == e.density));
        }
    }
}

#[test]
fn density_bounds_hold_in_both_coordinates() {
    let mut model = Model::random(2, 5, 2, 2);
    model.runs = vec![vec![200, 3, 309], vec![20, 1, 491]];
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for coordinates in Coordinates::ALL {
        let field = model.field(coordinates);
        let bounds = field.bounds();
        let [mut empty, mut full] = [0, 0];
        for _ in 0..300 {
            let mut draw = || Vec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..1.0_f32)));
            let min = (bounds.min() + draw().as_dvec3() * bounds.size() * 0.9).as_vec3();
            let size = 0.2 * bounds.longest_edge() as f32 * draw();
            let inside: Vec<Vec3> = (0..200).map(|_| min + draw() * size).collect();
            let mut densities = vec![0.0; 200];
            field.densities(&inside, &mut densities);
            let largest = densities.iter().copied().fold(0.0, f32::max);
            let bound = field.density_bound(min, min + size);
            assert!(bound.is_none_or(|bound| largest <= bound), "{largest} > {bound:?} from {min} by {size}");
            empty += usize::from(bound == Some(0.0));
            full += usize::from(largest > 0.0);
        }
        assert!(empty > 30 && full > 30, "{empty} {full}");
        assert_eq!(field.density_bound(Vec3::NAN, Vec3::ONE), None);
    }
}

#[test]
fn blender_coordinates_show_the_same_scene() {
    let mut model = Model::random(1, 7, 4, 1);
    // A layer of cells in the middle gives densities of the order of 1.
    model.runs = vec![vec![192, 128, 192]];
    let settings = RaySettings::default().occupancy(16);
    let resolution = Some([24, 16]);
    let images = Coordinates::ALL.map(|coordinates| {
        let field = model.field(coordinates);
        assert!((field.suggested_step() * coordinates.scale() - 0.01).abs() < 1e-15);
        let camera = field.cameras(&Intrinsics { fov_x: Some(0.6), resolution }).unwrap().unwrap()[0];
        let tracer = settings.tracer(&field, 0.0, &Silent).unwrap();
        render_view(&tracer, &camera, 0.5, &[], &Silent).unwrap()
    });
    let mut covered = 0;
    for (a, b) in images[0].pixels.iter().zip(&images[1].pixels) {
        // The samples are the same up to f32 rounding of positions (1e-7 of the box, times a slope of log σ
        // below 1e3). One sample more or less at the exit would show as 1e-2.
        assert!((a.color - b.color).abs().max_element() < 1e-3, "{} {}", a.color, b.color);
        covered += usize::from(a.opacity > 0.05 && a.opacity < 0.999);
    }
    assert!(covered > 100, "{covered} pixels show something translucent");
}

#[test]
fn cameras_need_an_angle_and_are_right_side_up() {
    let field = Model::random(1, 5, 2, 1).field(Coordinates::Ngp);
    let error = field.cameras(&Intrinsics::default()).unwrap_err().to_string();
    assert!(error.contains("angle of view"), "{error}");
    let cameras = field.cameras(&Intrinsics { fov_x: Some(0.8), resolution: None }).unwrap().unwrap();
    assert_eq!((cameras.len(), cameras[0].resolution), (1, RESOLUTION));
    let ray = cameras[0].ray(200.0, 0.0);
    assert!(ray.direction.z < 0.0 && ray.direction.y > 0.3, "forward is -z, the top row looks along +y: {ray:?}");
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    let message = |change: Change| {
        let mut model = Model::random(1, 5, 2, 1);
        change(&mut model);
        model.parse(Coordinates::Ngp).unwrap_err().to_string()
    };
    let cases: [(Change, [&str; 3]); 13] = [
        (&|m| m.kind = 3, ["qff_type", "1 to 2", "3"]),
        (&|m| m.quants = 6, ["qff_buffer", "2304 bytes", "1920 bytes"]),
        (&|m| m.quants = 1 << 40, ["n_quants", "2 to 1024", "1099511627776"]),
        (&|m| m.cells = 6, ["grid_res", "multiple of 4", "6"]),
        (&|m| m.tables[77] = f32::NAN, ["qff_buffer", "element 77", "NaN"]),
        (&|m| m.layers[1][3] = f32::INFINITY, ["qff_color_layer_0", "element 3", "inf"]),
        (&|m| m.layers[2].truncate(63), ["qff_color_layer_1", "256 bytes", "252 bytes"]),
        (&|m| m.runs = vec![vec![0, 513]], ["grid_rles", "512", "513"]),
        (&|m| m.freqs[2] = -1.0, ["freqs", "above 0", "-1"]),
        (&|m| m.poses[0][1][1] = 0.5, ["poses", "pose 0", "3x4"]),
        (&|m| m.poses[0][0][3] = f64::NAN, ["poses", "pose 0", "3x4"]),
        (&|m| m.poses[0][1][3] = f64::NAN, ["poses", "pose 0", "3x4"]),
        (&|m| m.poses[0][2][3] = f64::NAN, ["poses", "pose 0", "3x4"]),
    ];
    for (change, parts) in cases {
        let error = message(change);
        assert!(error.contains("model.ppng") && parts.iter().all(|part| error.contains(part)), "{error}");
    }
    assert!(parse(b"\xa0").unwrap_err().to_string().contains("`n_freqs`: expected a value, found none"));
    let twice = parse(b"\xa2\x64rank\x01\x64rank\x01").unwrap_err().to_string();
    assert!(twice.contains("every key once"), "{twice}");
    let longer = [Model::random(1, 5, 2, 1).bytes(), vec![0]].concat();
    assert!(parse(&longer).unwrap_err().to_string().contains("1 more bytes"));
}

/// Maps, lists, byte strings and texts claim 10¹² elements that are not there. A reader that believed one
/// would run out of memory.
#[test]
fn claimed_lengths_are_not_believed() {
    let claim = |major: u8| [&[major << 5 | 27], &1_000_000_000_000_u64.to_be_bytes()[..]].concat();
    let [bytes, text, list, map] = [2, 3, 4, 5].map(claim);
    let cases = [
        map.clone(),
        [&map[..], b"\x64rank\x01"].concat(),
        [b"\xa1".as_slice(), &text].concat(),
        [b"\xa1\x6aqff_buffer".as_slice(), &bytes].concat(),
        [b"\xa1\x65freqs".as_slice(), &list, &[0xf9, 0, 0]].concat(),
        [b"\xa1\x69grid_rles".as_slice(), &list, &list].concat(),
        [b"\xa1\x65poses".as_slice(), &list, &list, &list, &[0; 60]].concat(),
        [b"\xa1\x67unknown".as_slice(), &list, &list, &map].concat(),
    ];
    for case in cases {
        let error = parse(&case).unwrap_err().to_string();
        assert!(case.len() <= 100 && error.contains("CBOR map"), "{error}");
    }
}

#[test]
fn files_cut_anywhere_are_refused() {
    let bytes = Model::random(2, 4, 1, 1).bytes();
    assert!(parse(&bytes).is_ok());
    for length in 0..bytes.len() {
        assert!(parse(&bytes[..length]).is_err(), "the first {length} bytes");
    }
}
