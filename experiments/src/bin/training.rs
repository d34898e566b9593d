//! Question: how good are the models of `train`, and what do its defaults gain?
//!
//! Hash grids trained for a number of steps, which is the same on every machine: on a knot that this program makes, and
//! with data on lego and on the fox. PSNR is measured on held-out images. Writes the blocks of
//! `experiments/training.md`.

use std::path::Path;

use glam::{DVec3, Vec3};
use octobayes::geometry::{Domain, Norm};
use octobayes::monitor::Silent;
use octobayes::{Error, Result};
use octobayes_synth::{DatasetSettings, Up, write_dataset};
use octobayes_train::{DatasetFiles, Selection, Shot, TrainSettings, Trainer, quality};
use serde::{Deserialize, Serialize};

use common::clock::Clock;
use common::knot::knot;
use common::program::{Needs, Program};
use common::settings::seeds;
use common::table::{Table, mean, spread, whole, whole_spread};
use common::work::Work;

const SEEDS: [u64; 3] = [0, 1, 2];
/// Training views of a scene that is seen little.
const FEW: usize = 8;
/// Pixels of held-out images that are compared, about.
const PIXELS: usize = 20_000;
/// The contraction's radius that `octobayes train` takes by default.
const RADIUS: f64 = 1.515;

fn main() -> Result<()> {
    let parts = [("built-in", Needs::Nothing), ("lego", Needs::Data), ("fox", Needs::Data), ("choices", Needs::Data)];
    let program = Program::start("training", &parts)?;
    let defaults = TrainSettings::default();
    program.part("built-in", |work| {
        let folder = tempfile::tempdir().map_err(Error::io(Path::new("a temporary folder"), "cannot create"))?;
        let mesh = folder.path().join("knot.obj");
        std::fs::write(&mesh, knot()).map_err(Error::io(&mesh, "cannot write"))?;
        let data = folder.path().join("knot");
        let images = DatasetSettings::default().up(Up::Z).views(40).test_views(8).resolution([128; 2]);
        write_dataset(&mesh, &data, &images.samples_per_side(2), &Silent)?;
        let knot = |views: Selection| Dataset::open("knot, 128 × 128", &data, &views, None);
        let rows = [knot(Selection::Count(FEW))?, knot(Selection::All)?];
        let rows = [(&rows[0], 600, defaults), (&rows[1], 600, defaults)];
        Ok((words(&defaults), table(work, &rows)?))
    })?;
    let lego =
        |views: Selection| Dataset::open("lego, 400 × 400", &Program::data()?.join("nerf-lego-400"), &views, None);
    program.part("lego", |work| {
        let rows = [lego(Selection::Count(FEW))?, lego(Selection::All)?];
        let rows = [(&rows[0], 1000, defaults), (&rows[1], 1000, defaults), (&rows[1], 8000, defaults)];
        Ok((words(&defaults), table(work, &rows)?))
    })?;
    program.part("fox", |work| {
        let domain = Domain::contracted(DVec3::ZERO, RADIUS, Norm::Linf)?;
        let folder = Program::data()?.join("fox");
        let fox = |views: Selection| Dataset::open("fox, contracted", &folder, &views, Some(domain));
        let rows = [fox(Selection::Count(FEW))?, fox(Selection::All)?];
        let rows = [(&rows[0], 300, defaults), (&rows[1], 300, defaults)];
        Ok((words(&defaults), table(work, &rows)?))
    })?;
    program.part("choices", |work| {
        let data = lego(Selection::All)?;
        let rows: Vec<(&Dataset, u64, TrainSettings)> = choices().into_iter().map(|s| (&data, 400, s)).collect();
        Ok((words(&defaults), table(work, &rows)?))
    })
}

/// The defaults, and one thing changed.
fn choices() -> Vec<TrainSettings> {
    let defaults = TrainSettings::default();
    let config = defaults.config;
    vec![
        defaults,
        defaults.samples_per_step(1 << 13),
        defaults.samples_per_step(1 << 15),
        defaults.config(config.log2_hashmap_size(15)),
        defaults.config(config.log2_hashmap_size(17)),
        defaults.config(config.per_level_scale(1.4)),
        defaults.config(config.per_level_scale(1.6)),
        defaults.learning_rate(0.01),
        defaults.learning_rate(0.03),
        defaults.final_rate(0.1),
        defaults.distortion(0.001),
    ]
}

/// What differs from the defaults, in words.
fn difference(settings: &TrainSettings) -> String {
    let defaults = TrainSettings::default();
    let (a, b) = (settings.config, defaults.config);
    let changes = [
        (settings.samples_per_step != defaults.samples_per_step)
            .then(|| format!("{} samples a step", settings.samples_per_step)),
        (a.log2_hashmap_size != b.log2_hashmap_size).then(|| format!("2^{} entries a level", a.log2_hashmap_size)),
        (a.per_level_scale != b.per_level_scale).then(|| format!("scale {} per level", a.per_level_scale)),
        (settings.learning_rate != defaults.learning_rate).then(|| format!("rate {}", settings.learning_rate)),
        (settings.final_rate != defaults.final_rate).then(|| format!("{} of the rate left", settings.final_rate)),
        (settings.distortion != defaults.distortion).then(|| format!("distortion loss {}", settings.distortion)),
    ];
    let changes: Vec<String> = changes.into_iter().flatten().collect();
    if changes.is_empty() { "defaults".into() } else { changes.join(", ") }
}

/// Images to train on and to judge by.
struct Dataset {
    name: &'static str,
    train: Vec<Shot>,
    test: Vec<Shot>,
    domain: Domain,
}

impl Dataset {
    /// Opens a data set; `domain` stands for the box of its files.
    fn open(name: &'static str, folder: &Path, views: &Selection, domain: Option<Domain>) -> Result<Self> {
        let mut files = DatasetFiles::read(folder)?;
        files.select(views, None)?;
        let [train, test] = files.load(&Silent)?;
        Ok(Self { name, train, test, domain: domain.unwrap_or(Domain::Box(files.bounds)) })
    }
}

/// One training.
#[derive(Serialize, Deserialize)]
struct Row {
    rays: f64,
    /// Of processors, without measuring.
    seconds: f64,
    /// On held-out images, dB: after a quarter and half of the steps, and at the end.
    psnr: [f64; 3],
    /// On training images.
    trained: f64,
}

fn train(data: &Dataset, steps: u64, settings: TrainSettings) -> Result<Row> {
    let held_out = |trainer: &Trainer| {
        let field = trainer.field(serde_json::Value::Null);
        quality(&field, &data.test, Vec3::ONE, PIXELS).map_or(f64::NAN, |quality| quality.psnr)
    };
    let mut trainer = Trainer::new(settings, data.domain, &data.train)?;
    let (mut seconds, mut psnr) = (0.0, [0.0; 3]);
    for (psnr, end) in psnr.iter_mut().zip([steps / 4, steps / 2, steps]) {
        let clock = Clock::start();
        while trainer.steps() < end {
            trainer.step(trainer.steps() as f64 / steps as f64);
        }
        seconds += clock.elapsed().cpu;
        *psnr = held_out(&trainer);
    }
    let field = trainer.field(serde_json::Value::Null);
    let trained = quality(&field, &data.train, Vec3::ONE, PIXELS).map_or(f64::NAN, |quality| quality.psnr);
    Ok(Row { rays: trainer.rays() as f64, seconds, psnr, trained })
}

fn table(work: &Work, cases: &[(&Dataset, u64, TrainSettings)]) -> Result<String> {
    let mut table = Table::new(&[
        "data",
        "views",
        "settings",
        "steps",
        "rays",
        "processors, s",
        "PSNR train, dB",
        "PSNR held out: after a quarter",
        "half",
        "all",
        "held-out images",
    ]);
    for (data, steps, settings) in cases {
        let of = |seed| {
            let settings = settings.seed(seed);
            work.row((data.name, data.train.len(), steps, settings), || train(data, *steps, settings))
        };
        let rows = SEEDS.into_iter().map(of).collect::<Result<Vec<Row>>>()?;
        let of = |value: fn(&Row) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
        table.row(&[
            data.name.to_string(),
            data.train.len().to_string(),
            difference(settings),
            steps.to_string(),
            whole_spread(&of(|row| row.rays)),
            whole(mean(&of(|row| row.seconds))),
            spread(&of(|row| row.trained), 2),
            spread(&of(|row| row.psnr[0]), 2),
            spread(&of(|row| row.psnr[1]), 2),
            spread(&of(|row| row.psnr[2]), 2),
            data.test.len().to_string(),
        ]);
    }
    Ok(table.text().into())
}

fn words(settings: &TrainSettings) -> String {
    let config = settings.config;
    let resolutions = config.resolutions();
    format!(
        "Defaults: 2^{} entries a level, {} to {} cells per axis, {} samples a step, rate {} decaying to {} of it, \
         random background. {}",
        config.log2_hashmap_size,
        resolutions[0],
        resolutions[resolutions.len() - 1],
        settings.samples_per_step,
        settings.learning_rate,
        settings.final_rate,
        seeds(&SEEDS)
    )
}
