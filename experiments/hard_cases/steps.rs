//! The finite-difference step: errors of derivatives, Jacobians and log10 U against step and scheme, exact derivatives as truth.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{Estimation, FieldBuilder, GridSettings, Provenance, RaySettings};
use octobayes::field::{ClosedForm, Radiance, RadianceField, RadianceJet, VoxelGrid};
use octobayes::geometry::{Camera, Domain};
use octobayes::internal::{Curve, write_plot};
use octobayes::monitor::Silent;
use octobayes::octree::VertexId;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::{GradientMethod, RaySample, RaySamples};
use octobayes::uncertainty::{MOVED, Support, UncertaintyField};
use rayon::prelude::*;

use super::scenes::{Scene, data, lego, lego_mlp};
use super::waves::{Kind, Waves};

/// Steps per decade, from 1e-4 to 10 lattice edges.
const PER_DECADE: i32 = 4;
const RANGE: std::ops::RangeInclusive<i32> = -4 * PER_DECADE..=PER_DECADE;
const SCHEMES: [&str; 3] = ["one-sided", "central", "Richardson"];

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

/// Tables and plots of all fields.
pub fn steps() -> Result<()> {
    println!(
        "\n# Steps\n\nErrors relative to exact derivatives, root mean square weighted by what matters for H (‖∂C/∂σ‖ for ∇σ, w for ∇c); log10 U: mean |Δ| over vertices that moved by more than half a decade. Level 8."
    );
    let waves = |name, field: Box<dyn RadianceField>| Scene {
        name,
        field,
        cameras: ClosedForm::half_circle(10, [100, 100]),
        level: 8,
        rays: 64,
    };
    let mut scenes = vec![
        waves("smooth", Box::new(Waves(Kind::Smooth))),
        waves("exponential", Box::new(Waves(Kind::Exponential))),
        // 59 cells to 256: kinks at no lattice plane of ours but the middle.
        waves("piecewise linear", Box::new(VoxelGrid::bake(&Waves(Kind::Smooth), [60; 3], Vec3::Z))),
        waves("rounded to f16", Box::new(Waves(Kind::Half))),
    ];
    if let Some(data) = data() {
        scenes.push(Scene { name: "lego, Plenoptic PNG", rays: 1024, ..lego(&data)? });
        scenes.push(Scene { rays: 256, ..lego_mlp(&data)? });
    }
    let mut curves = Vec::new();
    for scene in &scenes {
        let errors = study(scene)?;
        let points = |scheme: usize, what: usize| {
            errors.iter().map(|(step, schemes)| (step.log10(), schemes[scheme][what].log10())).collect::<Vec<_>>()
        };
        curves.push(Curve { name: scene.name.into(), points: points(1, 2), reference: false });
        let schemes = (0..3).map(|s| Curve { name: SCHEMES[s].into(), points: points(s, 2), reference: false });
        let file =
            format!("experiments/hard_cases_steps_{}.svg", scene.name.replace([' ', ','], "_").replace("__", "_"));
        let title = format!("{}: error of G", scene.name);
        write_plot(
            Path::new(&file),
            &title,
            ["log10 step / lattice edges", "log10 relative error"],
            &schemes.collect::<Vec<_>>(),
        )?;
    }
    let title = "Central differences: error of G against step";
    let file = Path::new("experiments/hard_cases_steps.svg");
    write_plot(file, title, ["log10 step / lattice edges", "log10 relative error"], &curves)
}

fn settings(scene: &Scene) -> RaySettings {
    RaySettings::default().rays(scene.rays).gradient(GradientMethod::Analytic).occupancy(64)
}

/// The samples of a scene's rays with exact derivatives.
fn samples(scene: &Scene, grid: &GridSettings, domain: Domain) -> Result<Vec<Sample>> {
    let run =
        Estimation::new(&*scene.field, &scene.cameras).domain(domain).rays(settings(scene)).grid(*grid).prepare()?;
    let stream = run.stream();
    let field = scene.field.differentiable().expect("scenes of this study know their derivatives");
    let direction = |ray: u64| {
        let pick = stream.pixels.picks(ray, 1)[0];
        let [x, y] = pick.pixel.map(|i| f64::from(i) + stream.pixel_offset);
        let camera: &Camera = &scene.cameras[pick.camera];
        camera.ray(x, y).direction.as_vec3()
    };
    let mut out = Vec::new();
    stream.run(Shard::whole(scene.rays), RunProgress::default(), &Silent, |batches, _| {
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
fn differences(field: &dyn RadianceField, sample: &Sample, h: DVec3) -> [[DVec3; 4]; 3] {
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
    Ok(builder.finish(&Provenance { source: "steps".into(), progress, ..Provenance::default() }))
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

fn study(scene: &Scene) -> Result<Vec<(f64, [Errors; 3])>> {
    let domain = Domain::Box(scene.field.bounds());
    let grid = GridSettings::default().level(scene.level).tolerance(0.0).surface_points(0);
    let lattice = grid.lattice(domain)?;
    let samples = samples(scene, &grid, domain)?;
    let exact: Vec<[DVec3; 4]> = samples.iter().map(|s| s.exact).collect();
    let truth = field_of(&samples, &exact, scene.rays, grid, domain)?;
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
            let field = field_of(&samples, &derivatives, scene.rays, grid, domain)?;
            errors[3] = changes(&truth, &field);
        }
        out.push((step, errors));
    }
    report(scene, samples.len(), &out);
    let rays = settings(scene).gradient(GradientMethod::FiniteDifference);
    let run = Estimation::new(&*scene.field, &scene.cameras).rays(rays).grid(grid.tolerance(0.01)).prepare()?;
    if let Some(check) = run.check_step()? {
        let best = check.errors.best();
        println!(
            "\nThe tool's own estimate: noise {:.1e} of σ, best step {:.1e} with error {:.1e}; at the default {:.1e}{}",
            check.errors.noise,
            best.step,
            best.total(),
            check.errors.at(check.step).total(),
            if check.is_bad { ": it warns" } else { "" }
        );
    }
    Ok(out)
}

fn report(scene: &Scene, samples: usize, errors: &[(f64, [Errors; 3])]) {
    println!("\n## {}, {} rays, {samples} samples\n", scene.name, scene.rays);
    println!(
        "| step | one-sided ∇σ | ∇c | G | log10 U | central ∇σ | ∇c | G | log10 U | Richardson ∇σ | ∇c | G | log10 U |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (step, schemes) in errors {
        let cells: Vec<String> = schemes.iter().flatten().map(|e| format!("{e:.1e}")).collect();
        println!("| {step:.1e} | {} |", cells.join(" | "));
    }
    println!(
        "\n| scheme | evaluations | best step for G | error of G there | best step for log10 U | error there |\n|---|---|---|---|---|---|"
    );
    for (s, (name, evaluations)) in SCHEMES.iter().zip([4, 7, 13]).enumerate() {
        let best = |what: usize| {
            let least =
                errors.iter().filter(|e| e.1[s][what].is_finite()).min_by(|a, b| a.1[s][what].total_cmp(&b.1[s][what]));
            least.map_or("| ".into(), |e| format!("{:.1e} | {:.1e}", e.0, e.1[s][what]))
        };
        println!("| {name} | {evaluations} | {} | {} |", best(2), best(3));
    }
}
