//! Discs on a mesh, displaced and fitted again: what displacement do images leave, and does U rank it?
//!
//! Discs that lie on the surface are the truth, and their images are the data. The centres are displaced along the
//! normals by a smooth function, and Adam moves them until the images agree. What then is left of the displacement is
//! what images do not see. The upper half of each mesh has one colour.

use std::f64::consts::TAU;

use glam::{DVec3, Quat, Vec3};
use octobayes::Result;
use octobayes::estimate::RaySettings;
use octobayes::geometry::{Camera, Domain, Lattice};
use octobayes::metrics::median;
use octobayes::monitor::Silent;
use octobayes::rays::{Pixels, RunProgress, Shard};
use octobayes::render::{RenderedView, Renderer};
use octobayes_evaluation::metrics::{Detection, spearman};
use octobayes_splats::{RenderMode, SplatRenderer, Splats};
use octobayes_synth::{MeshScene, Texture, Up, viewpoints};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::blocks::Index;
use crate::scores::{self, LEVEL, NAMES};
use common::meshes::{self, MESHES, SIDES};
use common::surface;
use common::table::{Table, mean};
use common::work::Work;

const DISCS: usize = 5000;
/// Standard deviations of a disc, in distances between discs: within the surface and along the normal.
const WIDTH: f64 = 0.6;
const THICKNESS: f64 = 0.06;
/// Logit of the opacity, 0.9.
const LOGIT: f32 = 2.2;
/// Constant function of the spherical harmonics.
const CONSTANT: f64 = 0.282_094_791_773_878_14;
const VIEWS: u32 = 8;
const SIDE: u32 = 128;
const STEPS: usize = 240;
/// Root mean square displacement before the fit, in lengths of the mesh, and the waves that make it.
const DISPLACEMENT: f64 = 0.02;
const WAVES: usize = 12;
const SHORTEST: f64 = 0.4;
/// Adam: rate at the start, in lengths of the mesh, and what is left of it at the end; decays of the moments.
const RATE: f64 = 1.5e-3;
const FINAL: f64 = 0.02;
const DECAYS: [f64; 2] = [0.9, 0.999];
/// A disc is hidden if something stands in front of it by more than this part of the length.
const HIDDEN: f64 = 3e-3;
/// Scores that are not the same for all discs, of [`NAMES`].
const SHOWN: [usize; 9] = [0, 1, 3, 4, 5, 6, 7, 8, 12];

/// The figures of one score.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Figures {
    never_seen: f64,
    /// Spearman's ρ of the discs that a camera saw, with what is left of the displacement, and along the normal.
    ranks: [f64; 2],
}

/// A figure by its name.
type Shown = (&'static str, fn(&Figures) -> f64);

/// One mesh.
#[derive(Serialize, Deserialize)]
struct Row {
    /// Of the images before and after the fit, dB.
    psnr: [f64; 2],
    never_seen: f64,
    /// Median of what is left, of discs that a camera saw and of others, in lengths of the mesh.
    left: [f64; 2],
    scores: Vec<Figures>,
}

pub fn settings() -> String {
    format!(
        "{DISCS} discs, {VIEWS} views of one side, {SIDE} × {SIDE} pixels; displaced by {:.0} % of the length, {STEPS} \
         steps of Adam on the centres. Every pixel, level {LEVEL}, `--scale data` with the error of the images.",
        100.0 * DISPLACEMENT
    )
}

pub fn tables(work: &Work) -> Result<String> {
    let rows = MESHES.map(|(mesh, up)| work.row((mesh, DISCS, STEPS, SIDE), || measure(mesh, up)));
    let rows: Vec<Row> = rows.into_iter().collect::<Result<_>>()?;
    let head = ["mesh", "before the fit, dB", "after", "never seen", "left of the displacement, seen", "never seen"];
    let mut models = Table::new(&head);
    for ((mesh, _), row) in MESHES.iter().zip(&rows) {
        let psnr = row.psnr.map(|psnr| format!("{psnr:.1}"));
        let others = [row.never_seen, row.left[0], row.left[1]].map(|value| format!("{value:.4}"));
        models.row(&[vec![mesh.to_string()], psnr.to_vec(), others.to_vec()].concat());
    }
    let figures: [Shown; 3] = [
        ("AUROC of discs that no camera saw", |f| f.never_seen),
        ("Spearman's ρ with what is left of the displacement, discs that a camera saw", |f| f.ranks[0]),
        ("The same with what is left along the normal", |f| f.ranks[1]),
    ];
    let table = |(title, figure): &(&str, fn(&Figures) -> f64)| {
        let meshes = MESHES.iter().map(|(mesh, _)| *mesh);
        let head: Vec<&str> = ["score"].into_iter().chain(meshes).chain(["mean"]).collect();
        let mut table = Table::new(&head);
        for s in SHOWN {
            let values: Vec<f64> = rows.iter().map(|row| figure(&row.scores[s])).collect();
            let cells = values.iter().copied().chain([mean(&values)]).map(|value| format!("{value:.3}"));
            table.row(&[NAMES[s].to_string()].into_iter().chain(cells).collect::<Vec<_>>());
        }
        format!("{title}\n\n{}", table.text())
    };
    let others: Vec<String> = figures.iter().map(table).collect();
    Ok(format!("{}\n{}", models.text(), others.join("\n")))
}

fn measure(mesh: &str, up: Up) -> Result<Row> {
    let truth = meshes::read(mesh, up)?;
    let length = meshes::length(&truth);
    let discs = Discs::new(&truth);
    let cameras = viewpoints(VIEWS, SIDES[0].1, [SIDE; 2], 0);
    let images = discs.images(&discs.centres, &cameras)?;
    let mut moved = discs.displaced(DISPLACEMENT * length);
    let before = psnr(&discs.images(&moved, &cameras)?, &images);
    let mut adam = Adam::new(moved.len());
    for step in 0..STEPS {
        let view = step % cameras.len();
        let gradient = discs.gradient(&moved, &cameras[view], &images[view])?;
        adam.descend(&mut moved, &gradient, RATE * length * FINAL.powf(step as f64 / STEPS as f64));
    }
    let after = psnr(&discs.images(&moved, &cameras)?, &images);

    let centres: Vec<DVec3> = discs.centres.iter().map(|x| x.as_dvec3()).collect();
    let sightings = surface::sightings(&truth, &cameras, &centres, HIDDEN * length);
    let unseen: Vec<bool> = sightings.iter().map(|cameras| *cameras == 0).collect();
    let left: Vec<DVec3> = moved.iter().zip(&discs.centres).map(|(x, y)| (*x - *y).as_dvec3()).collect();
    let lengths: Vec<f64> = left.iter().map(|left| left.length()).collect();
    let along: Vec<f64> = left.iter().zip(&discs.normals).map(|(left, n)| left.dot(n.as_dvec3()).abs()).collect();
    let of = |values: &[f64], is_unseen: bool| -> Vec<f64> {
        values.iter().zip(&unseen).filter(|(_, unseen)| **unseen == is_unseen).map(|(value, _)| *value).collect()
    };
    let figures = |score: &Vec<f64>| Figures {
        never_seen: Detection::new(score, &unseen).map_or(f64::NAN, |found| found.auroc),
        ranks: [&lengths, &along].map(|truth| spearman(&of(score, false), &of(truth, false)).unwrap_or(0.0)),
    };
    let noise = 10_f64.powf(-after / 20.0);
    let scores = scores::all(&discs.at(&moved)?, &cameras, MeshScene::bounds(), noise)?;
    Ok(Row {
        psnr: [before, after],
        never_seen: of(&lengths, true).len() as f64 / lengths.len() as f64,
        left: [false, true].map(|is_unseen| median(of(&lengths, is_unseen)) / length),
        scores: scores.iter().map(figures).collect(),
    })
}

/// Discs on a surface.
struct Discs {
    centres: Vec<Vec3>,
    normals: Vec<Vec3>,
    colors: Vec<DVec3>,
    /// Distance between discs, scene units.
    spacing: f64,
}

impl Discs {
    /// Evenly by area.
    fn new(scene: &MeshScene) -> Self {
        let mesh = scene.mesh();
        let mut areas = vec![0.0];
        for face in 0..mesh.faces().len() as u32 {
            let [a, b, c] = mesh.corners(face);
            areas.push(areas[areas.len() - 1] + 0.5 * (b - a).cross(c - a).length());
        }
        let area = areas[areas.len() - 1];
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let (texture, plain) = (Texture::default(), DVec3::new(0.6, 0.5, 0.4));
        let (mut centres, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..DISCS {
            let at = area * (i as f64 + rng.random::<f64>()) / DISCS as f64;
            let face = areas.partition_point(|sum| *sum <= at).clamp(1, areas.len() - 1) - 1;
            let [a, b, c] = mesh.corners(face as u32);
            let [u, v]: [f64; 2] = rng.random();
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let x = a + u * (b - a) + v * (c - a);
            centres.push(x.as_vec3());
            normals.push((b - a).cross(c - a).normalize_or(DVec3::Z).as_vec3());
            colors.push(if x.z > 0.0 { plain } else { texture.mesh(x) });
        }
        Self { centres, normals, colors, spacing: (area / DISCS as f64).sqrt() }
    }

    /// The discs with other centres.
    fn at(&self, centres: &[Vec3]) -> Result<Splats> {
        let [wide, thin] = [WIDTH, THICKNESS].map(|width| (width * self.spacing).ln() as f32);
        let n = centres.len();
        Splats::new(
            centres.to_vec(),
            vec![Vec3::new(wide, wide, thin); n],
            self.normals.iter().map(|n| Quat::from_rotation_arc(Vec3::Z, *n)).collect(),
            vec![LOGIT; n],
            self.colors.iter().flat_map(|c| ((*c - 0.5) / CONSTANT).as_vec3().to_array()).collect(),
            0,
            RenderMode::Classic,
        )
    }

    /// The centres, displaced along the normals by a smooth function of this root mean square.
    fn displaced(&self, by: f64) -> Vec<Vec3> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let waves: Vec<(DVec3, f64)> = (0..WAVES)
            .map(|_| {
                let direction = DVec3::from(rng.random::<[f64; 3]>()) - 0.5;
                let wavelength = SHORTEST * (1.0 + 2.0 * rng.random::<f64>());
                (direction.normalize_or(DVec3::X) * TAU / wavelength, TAU * rng.random::<f64>())
            })
            .collect();
        let amplitude = by * (2.0 / WAVES as f64).sqrt();
        let of = |(x, n): (&Vec3, &Vec3)| {
            let sum: f64 = waves.iter().map(|(k, phase)| (k.dot(x.as_dvec3()) + phase).sin()).sum();
            *x + (amplitude * sum) as f32 * *n
        };
        self.centres.iter().zip(&self.normals).map(of).collect()
    }

    fn images(&self, centres: &[Vec3], cameras: &[Camera]) -> Result<Vec<Vec<DVec3>>> {
        let splats = self.at(centres)?;
        let renderer = SplatRenderer::new(&splats, Vec3::ONE);
        let colors = |view: RenderedView| view.pixels.iter().map(|pixel| pixel.color).collect();
        cameras.iter().map(|camera| renderer.image(camera, 0.5, &[], &Silent).map(colors)).collect()
    }

    /// Derivatives of the mean squared error of one image by the centres.
    fn gradient(&self, centres: &[Vec3], camera: &Camera, image: &[DVec3]) -> Result<Vec<DVec3>> {
        let found = self.images(centres, &[*camera])?.swap_remove(0);
        let splats = self.at(centres)?;
        let (index, cameras) = (Index::new(&splats), [*camera]);
        let settings = RaySettings::default().pixels(Pixels::Every).background(Vec3::ONE);
        let lattice = Lattice::from_domain(Domain::Box(splats.bounds()), 4)?;
        let stream = settings.stream(&splats, &cameras, &lattice, &Silent)?;
        let mut gradient = vec![DVec3::ZERO; centres.len()];
        let mut first = 0;
        let whole = Shard::whole(camera.pixels());
        stream.run(whole, RunProgress::default(), &Silent, |batches, _| {
            for batch in batches {
                for (ray, samples) in batch.iter() {
                    // Rays are sorted by tile: which pixel it is, its direction tells.
                    let seen = batch.sight[(ray - first) as usize].ray;
                    let Some(([x, y], _)) = camera.project(seen.at(1.0)) else { continue };
                    let pixel = y as usize * camera.resolution[0] as usize + x as usize;
                    let error = 2.0 / image.len() as f64 * (found[pixel] - image[pixel]);
                    for i in samples {
                        let j = &batch.jacobians[i];
                        let by = |axis: usize| (0..3).map(|c| error[c] * f64::from(j[3 * c + axis])).sum();
                        gradient[index.of(batch.positions[i])] += DVec3::from([0, 1, 2].map(by));
                    }
                }
                first += batch.sight.len() as u64;
            }
            Ok(())
        })?;
        Ok(gradient)
    }
}

fn psnr(found: &[Vec<DVec3>], truth: &[Vec<DVec3>]) -> f64 {
    octobayes::metrics::psnr(&found.concat(), &truth.concat())
}

/// Adam (Kingma, Ba 2015) on centres.
struct Adam {
    /// Running means of gradients and of their squares.
    moments: Vec<[DVec3; 2]>,
    steps: i32,
}

impl Adam {
    fn new(count: usize) -> Self {
        Self { moments: vec![[DVec3::ZERO; 2]; count], steps: 0 }
    }

    fn descend(&mut self, centres: &mut [Vec3], gradient: &[DVec3], rate: f64) {
        self.steps += 1;
        let [first, second] = DECAYS.map(|decay| 1.0 - decay.powi(self.steps));
        for ((x, g), [m, v]) in centres.iter_mut().zip(gradient).zip(&mut self.moments) {
            *m = DECAYS[0] * *m + (1.0 - DECAYS[0]) * *g;
            *v = DECAYS[1] * *v + (1.0 - DECAYS[1]) * *g * *g;
            let root = (*v / second).map(f64::sqrt) + 1e-15;
            *x -= (rate * (*m / first) / root).as_vec3();
        }
    }
}
