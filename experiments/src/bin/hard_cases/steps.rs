//! The finite-difference step: errors of derivatives, Jacobians and log10 U against step and scheme, exact derivatives
//! as truth.

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{FieldBuilder, FieldSource, GridSettings, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField, RadianceJet, TrainedField, VoxelGrid};
use octobayes::geometry::Domain;
use octobayes::monitor::Silent;
use octobayes::octree::VertexId;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::{GradientMethod, RaySample, RaySamples};
use octobayes::uncertainty::{MOVED, Support, UncertaintyField};
use octobayes_show::picture::{Curve, write_plot};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::waves::{Kind, Waves};
use common::program::folder;
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, mean, spread_e};
use common::work::Work;

/// Steps per decade, from 1e-4 to 10 lattice edges.
const PER_DECADE: i32 = 4;
const RANGE: std::ops::RangeInclusive<i32> = -4 * PER_DECADE..=PER_DECADE;
const SCHEMES: [&str; 3] = ["one-sided", "central", "Richardson"];
/// Index of the scheme that the crate uses.
const CENTRAL: usize = 1;
const SEEDS: [u64; 3] = [0, 1, 2];

/// A sample with its exact derivatives.
struct Sample {
    x: Vec3,
    direction: Vec3,
    ray: u64,
    weight: f64,
    /// ∂C/∂σ.
    derivative: DVec3,
    /// ∇σ; ∂c/∂x, ∂c/∂y, ∂c/∂z.
    exact: [DVec3; 4],
}

/// Errors of one scheme at one step: ∇σ, ∇c, G, relative; mean |Δ log10 U| of moved vertices.
type Errors = [f64; 4];

/// What the program itself says of a field's step.
#[derive(Serialize, Deserialize)]
struct Check {
    noise: f64,
    best: f64,
    error: f64,
    at_default: f64,
    is_bad: bool,
}

/// Errors of all schemes by step, and the program's own estimate.
#[derive(Serialize, Deserialize)]
struct Study {
    samples: usize,
    errors: Vec<(f64, [Errors; 3])>,
    check: Option<Check>,
}

/// Fields whose derivatives are known.
pub fn waves() -> Vec<Scene> {
    let scene = |name, field: Box<dyn TrainedField>| Scene {
        name,
        field,
        cameras: ClosedForm::half_circle(10, [100, 100]),
        settings: RaySettings::default().rays(64),
        grid: GridSettings::default(),
    };
    vec![
        scene("smooth", Box::new(Waves(Kind::Smooth))),
        scene("exponential", Box::new(Waves(Kind::Exponential))),
        // 59 cells to 256: kinks at no lattice plane of ours but the middle.
        scene("piecewise linear", Box::new(VoxelGrid::bake(&Waves(Kind::Smooth), [60; 3], Vec3::Z))),
        scene("rounded to f16", Box::new(Waves(Kind::Half))),
    ]
}

/// The studies of a field, one a seed.
struct Studied<'a> {
    scene: &'a Scene,
    studies: Vec<Study>,
}

impl Studied<'_> {
    /// Errors of all seeds at a step.
    fn errors(&self, step: usize, scheme: usize, what: usize) -> Vec<f64> {
        self.studies.iter().map(|study| study.errors[step].1[scheme][what]).collect()
    }

    /// The steps.
    fn steps(&self) -> impl Iterator<Item = (usize, f64)> {
        self.studies[0].errors.iter().map(|e| e.0).enumerate()
    }

    /// The step with the least mean error, and that error.
    fn best(&self, scheme: usize, what: usize) -> [String; 2] {
        let of = |i: usize| mean(&self.errors(i, scheme, what));
        let finite = self.steps().filter(|(i, _)| of(*i).is_finite());
        let least = finite.min_by(|a, b| of(a.0).total_cmp(&of(b.0)));
        least.map_or([String::new(), String::new()], |(i, step)| {
            [format!("{step:.1e}"), spread_e(&self.errors(i, scheme, what))]
        })
    }
}

/// Tables of some fields, and a plot of central differences.
pub fn steps(work: &Work, scenes: &[Scene], plot: &str) -> Result<(String, String)> {
    let mut all = Vec::new();
    for scene in scenes {
        let of = |seed| work.row((scene.name, scene.settings.rays, seed), || study(scene, seed));
        all.push(Studied { scene, studies: SEEDS.into_iter().map(of).collect::<Result<_>>()? });
    }
    let head: Vec<&str> = ["step"].into_iter().chain(scenes.iter().map(|scene| scene.name)).collect();
    let table = |what: usize| {
        let mut table = Table::new(&head);
        for (i, step) in all[0].steps() {
            let cells = all.iter().map(|studied| spread_e(&studied.errors(i, CENTRAL, what)));
            table.row(&[format!("{step:.1e}")].into_iter().chain(cells).collect::<Vec<_>>());
        }
        table
    };
    let mut best = Table::new(&[
        "field",
        "scheme",
        "evaluations",
        "best step for G",
        "error of G",
        "best step for log10 U",
        "error of log10 U",
    ]);
    let mut checks =
        Table::new(&["field", "noise of σ", "its best step", "its error of ∇σ", "at the default", "warns"]);
    for studied in &all {
        let name = studied.scene.name.to_string();
        for (s, (scheme, evaluations)) in SCHEMES.iter().zip([4, 7, 13]).enumerate() {
            let head = [name.clone(), (*scheme).to_string(), evaluations.to_string()];
            best.row(&[&head[..], &studied.best(s, 2), &studied.best(s, 3)].concat());
        }
        let checked: Vec<&Check> = studied.studies.iter().filter_map(|study| study.check.as_ref()).collect();
        if !checked.is_empty() {
            let of = |value: fn(&Check) -> f64| spread_e(&checked.iter().map(|c| value(c)).collect::<Vec<f64>>());
            let warned = checked.iter().filter(|c| c.is_bad).count();
            let warns = format!("{warned} of {} seeds", checked.len());
            checks.row(&[name, of(|c| c.noise), of(|c| c.best), of(|c| c.error), of(|c| c.at_default), warns]);
        }
    }
    let curve = |studied: &Studied| Curve {
        name: studied.scene.name.into(),
        points: studied.steps().map(|(i, step)| (step.log10(), mean(&studied.errors(i, CENTRAL, 2)).log10())).collect(),
        reference: false,
    };
    let curves: Vec<Curve> = all.iter().map(curve).collect();
    let title = "Central differences: error of G against step";
    write_plot(&folder().join(plot), title, ["log10 step / lattice edges", "log10 relative error"], &curves)?;
    let counts: Vec<String> = all
        .iter()
        .map(|Studied { scene, studies }| {
            format!("{}: {} rays, {} samples", scene.name, scene.settings.rays, studies[0].samples)
        })
        .collect();
    let described = describe(&settings(&scenes[0]), &scenes[0].grid.tolerance(0.0), &["rays", "gradient", "step"]);
    let words = format!("{described} {} {} (of the first seed).", seeds(&SEEDS), counts.join("; "));
    let body = format!(
        "Central differences, error of log10 U:\n\n{}\nCentral differences, error of G:\n\n{}\nBest steps:\n\n{}\nWhat \
         the program says of its own accord, from 256 points:\n\n{}",
        table(3).text(),
        table(2).text(),
        best.text(),
        checks.text()
    );
    Ok((words, body))
}

fn settings(scene: &Scene) -> RaySettings {
    scene.settings.gradient(GradientMethod::Analytic).occupancy(64)
}

/// The samples of a scene's rays with exact derivatives.
fn samples(scene: &Scene, seed: u64, grid: &GridSettings) -> Result<Vec<Sample>> {
    let run = scene.estimation(settings(scene).seed(seed), *grid).prepare()?;
    let stream = run.stream();
    let field = scene.field.differentiable().expect("scenes of this study know their derivatives");
    let direction = |ray: u64| {
        let pick = stream.pixels.picks(ray, 1)[0];
        let [x, y] = pick.pixel.map(|i| f64::from(i) + stream.pixel_offset);
        scene.cameras[pick.camera].ray(x, y).direction.as_vec3()
    };
    let mut out = Vec::new();
    stream.run(Shard::whole(scene.settings.rays), RunProgress::default(), &Silent, |batches, _| {
        for batch in batches {
            for (ray, range) in batch.iter() {
                let positions = &batch.positions[range.clone()];
                let directions = vec![direction(ray); positions.len()];
                let mut jets = vec![RadianceJet::default(); positions.len()];
                field.jets(positions, &directions, &mut jets);
                for ((i, &x), jet) in range.zip(positions).zip(jets) {
                    let gradient = jet.density_gradient.as_dvec3();
                    let colors = jet.color_gradients.map(Vec3::as_dvec3);
                    let weight = f64::from(batch.weights[i]);
                    // G − w ∇c = ∂C/∂σ ∇σᵀ.
                    let rest = |c: usize| {
                        DVec3::from(std::array::from_fn(|k| {
                            f64::from(batch.jacobians[i][3 * c + k]) - weight * colors[k][c]
                        }))
                    };
                    if gradient.length_squared() > 0.0 {
                        let derivative =
                            DVec3::from([0, 1, 2].map(|c| rest(c).dot(gradient) / gradient.length_squared()));
                        let exact = [gradient, colors[0], colors[1], colors[2]];
                        out.push(Sample { x, direction: directions[0], ray, weight, derivative, exact });
                    }
                }
            }
        }
        Ok(())
    })?;
    Ok(out)
}

/// ∇σ and ∂c/∂x, ∂c/∂y, ∂c/∂z of a sample by each scheme over a step h.
fn differences(field: &dyn TrainedField, sample: &Sample, h: DVec3) -> [[DVec3; 4]; 3] {
    let bounds = field.bounds();
    let mut places = vec![sample.x];
    for axis in 0..3 {
        for k in [-2.0, -1.0, 1.0, 2.0] {
            let y = (sample.x.as_dvec3() + k * h[axis] * DVec3::AXES[axis]).as_vec3();
            places.push(bounds.clamp(y));
        }
    }
    let mut values = vec![Radiance::default(); places.len()];
    field.evaluate(&places, &vec![sample.direction; places.len()], &mut values);
    let mut out = [[DVec3::ZERO; 4]; 3];
    for axis in 0..3 {
        let at = |i: usize| [1 + 4 * axis, 2 + 4 * axis, 0, 3 + 4 * axis, 4 + 4 * axis][i];
        // By the distance that f32 positions really have.
        let between = |a: usize, b: usize| {
            let (a, b) = (at(a), at(b));
            let width = f64::from(places[b][axis]) - f64::from(places[a][axis]);
            let scale = if width > 0.0 { 1.0 / width } else { 0.0 };
            let density = f64::from(values[b].density) - f64::from(values[a].density);
            (density * scale, (values[b].color.as_dvec3() - values[a].color.as_dvec3()) * scale)
        };
        let ((one, one_color), (near, near_color), (far, far_color)) = (between(2, 3), between(1, 3), between(0, 4));
        let schemes =
            [(one, one_color), (near, near_color), ((4.0 * near - far) / 3.0, (4.0 * near_color - far_color) / 3.0)];
        for (scheme, (density, color)) in out.iter_mut().zip(schemes) {
            scheme[0][axis] = density;
            scheme[1 + axis] = color;
        }
    }
    out
}

impl Sample {
    /// G from derivatives: columns ∂C/∂x, ∂C/∂y, ∂C/∂z.
    fn jacobian(&self, d: &[DVec3; 4]) -> [DVec3; 3] {
        [0, 1, 2].map(|axis| self.derivative * d[0][axis] + self.weight * d[1 + axis])
    }
}

/// The field of the samples' rays with these derivatives.
fn field_of(
    samples: &[Sample],
    derivatives: &[[DVec3; 4]],
    rays: u64,
    grid: GridSettings,
    domain: Domain,
) -> Result<UncertaintyField> {
    let mut batch = RaySamples::default();
    for (sample, d) in samples.iter().zip(derivatives) {
        let columns = sample.jacobian(d);
        let jacobian = std::array::from_fn(|i| columns[i % 3][i / 3] as f32);
        batch.push(sample.ray, RaySample { position: sample.x, jacobian, weight: 1.0 });
    }
    let mut builder = FieldBuilder::new(grid, domain)?;
    builder.add(&[batch]);
    let progress = RunProgress { rays, ..RunProgress::default() };
    builder.finish(&FieldSource { source: "steps".into(), progress, ..FieldSource::default() })
}

/// Mean |Δ log10 U| over the vertices that moved by more than half a decade.
fn changes(truth: &UncertaintyField, field: &UncertaintyField) -> f64 {
    let (Support::Octree(a), Support::Octree(b)) = (truth.support(), field.support()) else { return f64::NAN };
    let moved = truth.prior() * 10_f64.powf(-MOVED);
    let pairs = a.vertex_positions().zip(truth.deviations().iter()).filter(|(_, sigma)| *sigma < moved);
    let there = |point| b.vertex(point).map_or(field.prior(), |VertexId(v)| field.deviations().get(v as usize));
    let changes: Vec<f64> = pairs.map(|(point, sigma)| (sigma / there(point)).log10().abs()).collect();
    changes.iter().sum::<f64>() / changes.len() as f64
}

fn study(scene: &Scene, seed: u64) -> Result<Study> {
    let domain = Domain::Box(scene.field.bounds());
    let grid = scene.grid.tolerance(0.0);
    let lattice = grid.lattice(domain)?;
    let samples = samples(scene, seed, &grid)?;
    let exact: Vec<[DVec3; 4]> = samples.iter().map(|s| s.exact).collect();
    let truth = field_of(&samples, &exact, scene.settings.rays, grid, domain)?;
    let mut out = Vec::new();
    for step in RANGE.map(|k| 10_f64.powf(f64::from(k) / f64::from(PER_DECADE))) {
        let found: Vec<[[DVec3; 4]; 3]> =
            samples.par_iter().map(|s| differences(&*scene.field, s, step * lattice.edge())).collect();
        let mut errors = [[0.0; 4]; 3];
        for (scheme, errors) in errors.iter_mut().enumerate() {
            let relative = |size: &dyn Fn(&Sample, &[DVec3; 4]) -> f64| {
                let (mut off, mut all) = (0.0, 0.0);
                for (sample, found) in samples.iter().zip(&found) {
                    off += size(sample, &std::array::from_fn(|k| found[scheme][k] - sample.exact[k]));
                    all += size(sample, &sample.exact);
                }
                f64::sqrt(off / all)
            };
            let squares = |d: &[DVec3]| d.iter().map(|v| v.length_squared()).sum::<f64>();
            errors[0] = relative(&|s, d| s.derivative.length_squared() * d[0].length_squared());
            errors[1] = relative(&|s, d| s.weight * s.weight * squares(&d[1..]));
            errors[2] = relative(&|s, d| squares(&s.jacobian(d)));
            let derivatives: Vec<[DVec3; 4]> = found.iter().map(|f| f[scheme]).collect();
            let field = field_of(&samples, &derivatives, scene.settings.rays, grid, domain)?;
            errors[3] = changes(&truth, &field);
        }
        out.push((step, errors));
    }
    let rays = settings(scene).seed(seed).gradient(GradientMethod::FiniteDifference);
    let check = scene.estimation(rays, grid.tolerance(0.01)).prepare()?.check_step()?.map(|check| {
        let best = check.errors.best();
        Check {
            noise: check.errors.noise,
            best: best.step,
            error: best.total(),
            at_default: check.errors.at(check.step).total(),
            is_bad: check.is_bad,
        }
    });
    Ok(Study { samples: samples.len(), errors: out, check })
}
