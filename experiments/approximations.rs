//! Question: what do the two approximations of a ray's Jacobian cost: leaving samples out, and the finite-difference step?
//!
//! Cutoff: fields with samples left out at several cutoffs against one with nothing left out (no occupancy grid, no early end
//! of rays, every sample differentiated), same rays. Step: fields at several steps against the best reference there is: on
//! the closed-form courtyard a step of 1/64 edge, where central differences have converged; on trained models their own exact derivatives, with the
//! time that both take; and each step against its half, which needs no reference. Every row is |Δ log10 U| over 200,000 surface points.
//!
//! Without `OCTOBAYES_DATA` only the courtyard is measured. Prints the tables of `experiments/approximations.md`.

use std::path::PathBuf;
use std::time::Instant;

use octobayes::Result;
use octobayes::dataset::Views;
use octobayes::estimate::{Estimation, GridSettings, Outcome, RaySettings};
use octobayes::field::{ClosedForm, Coordinates, NerfMlp, RadianceField};
use octobayes::geometry::Camera;
use octobayes::open::open_in;
use octobayes::render::GradientMethod;
use octobayes::uncertainty::{Difference, UncertaintyField, compare};

struct Case {
    name: &'static str,
    field: Box<dyn RadianceField>,
    cameras: Vec<Camera>,
    level: u8,
    rays: u64,
}

fn main() -> Result<()> {
    let mut cases = vec![Case {
        name: "courtyard",
        field: Box::new(ClosedForm::courtyard()),
        cameras: ClosedForm::half_circle(40, [200, 200]),
        level: 7,
        rays: 20_480,
    }];
    if let Some(data) = std::env::var_os("OCTOBAYES_DATA") {
        let folder = PathBuf::from(data).join("nerf-mlp-pretrained");
        cases.push(Case {
            name: "lego MLP",
            field: Box::new(NerfMlp::read(&folder.join("lego.safetensors"))?),
            cameras: Views::read(&folder.join("cameras/lego_train.json"), Some([400, 400]))?.cameras(),
            level: 8,
            rays: 20_480,
        });
        let model = folder.with_file_name("ppng-pretrained").join("NeRFSynthetic/ppng_1/lego.ppng");
        cases.push(Case {
            name: "lego Plenoptic PNG, type 1",
            field: open_in(&model.to_string_lossy(), Some(Coordinates::Blender))?,
            cameras: Views::read(&folder.join("cameras/lego_train.json"), Some([400, 400]))?.cameras(),
            level: 8,
            rays: 102_400,
        });
    }
    for case in &cases {
        cutoffs(case)?;
        steps(case)?;
    }
    Ok(())
}

fn run(case: &Case, settings: RaySettings) -> Result<(UncertaintyField, u64, f64)> {
    let grid = GridSettings::default().level(case.level).tolerance(0.0).surface_points(200_000);
    let start = Instant::now();
    let rays = settings.rays(case.rays);
    let Outcome { field, progress, .. } = Estimation::new(&*case.field, &case.cameras).rays(rays).grid(grid).run()?;
    Ok((field, progress.samples, start.elapsed().as_secs_f64()))
}

fn columns(difference: &Option<Difference>) -> String {
    difference.as_ref().map_or(String::new(), |d| {
        format!("{:.2e} | {:.2e} | {:.2e} | {:.4}", d.mean, d.percentile_95, d.percentile_99, d.max)
    })
}

fn cutoffs(case: &Case) -> Result<()> {
    println!("\n## Leaving samples out: {}, level {}, {} rays\n", case.name, case.level, case.rays);
    println!("| cutoff | samples | seconds | mean, surfaces | 95 % | 99 % | max | mean, box | 95 % | 99 % | max |");
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let (all, samples, seconds) = run(case, RaySettings::default().cutoff(0.0))?;
    println!("| 0 | {samples} | {seconds:.1} | | | | | | | | |");
    for cutoff in [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3] {
        let (some, samples, seconds) = run(case, RaySettings::default().cutoff(cutoff))?;
        let d = compare(&some, &all, 200_000, 0)?;
        println!("| {cutoff:e} | {samples} | {seconds:.1} | {} | {} |", columns(&d.on_surfaces), columns(&d.in_box));
    }
    Ok(())
}

fn steps(case: &Case) -> Result<()> {
    println!("\n## Finite-difference step: {}, level {}, {} rays\n", case.name, case.level, case.rays);
    println!("| step h, lattice edges | against | mean | 95 % | 99 % | max |");
    println!("|---|---|---|---|---|---|");
    let settings = |step| RaySettings::default().step(Some(step)).cutoff(1e-6);
    let field = |step| run(case, settings(step)).map(|r| r.0);
    let steps: Vec<f64> = (-12..=1).map(|k| 2_f64.powi(k)).collect();
    let (name, reference) = if case.field.differentiable().is_some() {
        let exact = settings(1.0 / 128.0).gradient(GradientMethod::Analytic);
        let (field, _, seconds) = run(case, exact)?;
        let differences = run(case, settings(1.0 / 128.0))?.2;
        println!("| | exact: {seconds:.2} s, differences: {differences:.2} s | | | | |");
        ("exact", field)
    } else {
        ("1/64", field(1.0 / 64.0)?)
    };
    let mut half = field(2_f64.powi(-13))?;
    for &step in &steps {
        let this = field(step)?;
        let [fixed, halved] = [&reference, &half].map(|other| compare(&this, other, 200_000, 0).map(|d| d.on_surfaces));
        println!("| {step} | {name} | {} |", columns(&fixed?));
        println!("| {step} | h/2 | {} |", columns(&halved?));
        half = this;
    }
    Ok(())
}
