//! Question: which scalar, read off the Hessian, ranks the depth error best, and does it depend on the level?
//!
//! Lego twice, as a Plenoptic PNG and as an MLP, levels 6 to 9, all levels of a seed from the same rays. AUSE of the
//! median depth's absolute error over test views, every covariance with every ray average. Writes the blocks of
//! `experiments/covariance.md`.

use octobayes::Result;
use octobayes::posterior::Covariance;
use octobayes::render::{GradientMethod, RayAverage};
use octobayes::uncertainty::UncertaintyField;
use octobayes_evaluation::Reading;

use common::program::{Needs, Program};
use common::ranking::{Ranking, Truth};
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, spread, whole, whole_spread};
use common::work::Work;

const COVARIANCES: [Covariance; 3] = [Covariance::Diagonal, Covariance::Trace, Covariance::Block];
const AVERAGES: [RayAverage; 2] = [RayAverage::WeightedMean, RayAverage::USpread];
const LEVELS: [u8; 4] = [6, 7, 8, 9];
const SEEDS: [u64; 3] = [0, 1, 2];
/// Of the test views one in so many, and of their pixels along x and y.
const EVERY: usize = 2;
const STRIDE: u32 = 4;

fn main() -> Result<()> {
    let program = Program::start("covariance", &[("png", Needs::Data), ("mlp", Needs::Data)])?;
    program.part("png", |work| study(work, &Scene::lego(&Program::data()?)?))?;
    program.part("mlp", |work| {
        let scene = Scene::lego_mlp(&Program::data()?)?;
        study(work, &Scene { settings: scene.settings.rays(102_400), ..scene })
    })
}

/// A seed's fields of all levels, with the vertices of each.
fn fields(scene: &Scene, seed: u64) -> Result<Vec<UncertaintyField>> {
    let rays = scene.settings.seed(seed).gradient(GradientMethod::Auto);
    let grids = LEVELS.map(|level| scene.grid.level(level));
    let outcomes = scene.estimation(rays, grids[0]).prepare()?.finish_on(&grids)?;
    Ok(outcomes.into_iter().map(|outcome| outcome.field).collect())
}

fn study(work: &Work, scene: &Scene) -> Result<(String, String)> {
    let truth = Truth::lego(&Program::data()?, EVERY, STRIDE)?;
    // One rendering for all seeds: the views do not depend on U.
    let (vertices, ranking): (Vec<Vec<usize>>, Ranking) =
        work.row((scene.name, scene.settings.rays, LEVELS, SEEDS, EVERY, STRIDE), || {
            let (mut vertices, mut readings) = (Vec::new(), Vec::new());
            for seed in SEEDS {
                let fields = fields(scene, seed)?;
                vertices.push(fields.iter().map(|field| field.deviations().len()).collect());
                for field in fields {
                    for covariance in COVARIANCES {
                        let field = field.clone().with_covariance(covariance)?.without_sums();
                        readings.push(Reading { name: covariance.name().into(), field, averages: AVERAGES.to_vec() });
                    }
                }
            }
            Ok((vertices, truth.rank(scene, &readings)?))
        })?;

    let columns: Vec<String> =
        AVERAGES.iter().flat_map(|a| COVARIANCES.map(|c| format!("{}, {}", c.name(), a.name()))).collect();
    let head: Vec<&str> = ["level", "vertices"].into_iter().chain(columns.iter().map(String::as_str)).collect();
    let mut table = Table::new(&head);
    for (l, level) in LEVELS.iter().enumerate() {
        let counts: Vec<f64> = vertices.iter().map(|levels| levels[l] as f64).collect();
        let mut row = vec![level.to_string(), whole_spread(&counts)];
        for a in 0..AVERAGES.len() {
            for c in 0..COVARIANCES.len() {
                let reading = |seed: usize| (seed * LEVELS.len() + l) * COVARIANCES.len() + c;
                let of = |seed: usize| ranking.ranks[reading(seed) * AVERAGES.len() + a].mae;
                row.push(spread(&(0..SEEDS.len()).map(of).collect::<Vec<f64>>(), 3));
            }
        }
        table.row(&row);
    }
    let mut others = Table::new(&["without a Hessian", "AUSE"]);
    for rank in &ranking.ranks[SEEDS.len() * LEVELS.len() * COVARIANCES.len() * AVERAGES.len()..] {
        others.row(&[rank.name.clone(), format!("{:.3}", rank.mae)]);
    }
    let depth = ranking.depth;
    let words = format!(
        "{}. {} {} {} test views, every {STRIDE}th pixel along x and y: {} pixels, whose depth is off by {:.4} scene \
         units in the median and {:.4} in the mean.",
        scene.name,
        describe(&scene.settings.gradient(GradientMethod::Auto), &scene.grid, &["level", "covariance"]),
        seeds(&SEEDS),
        truth.views(),
        whole(depth.pixels as f64),
        depth.median,
        depth.mean,
    );
    Ok((words, format!("{}\n{}", table.text(), others.text())))
}
