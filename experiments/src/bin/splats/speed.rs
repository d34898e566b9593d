//! Processor time of a run and of its parts.

use std::hint::black_box;

use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain, Lattice};
use octobayes::glam::Vec3;
use octobayes::monitor::Silent;
use octobayes::rays::{RunProgress, Shard};
use octobayes::render::Outputs;
use octobayes_splats::{Hits, SplatRenderer};

use common::ball::{ball, cameras};
use common::clock::{Clock, Time};
use common::table::Table;
use common::work::Work;

const SPLATS: usize = 100_000;
const VIEWS: u32 = 100;
const RAYS: u64 = 4_096_000;
const LEVEL: u8 = 7;

pub fn settings() -> String {
    format!("{SPLATS} splats of degree 3 on a ball, {VIEWS} views of 400 × 400 pixels, level {LEVEL}, seed 0.")
}

/// What is timed.
const PARTS: [(&str, Part); 5] = [
    ("prepare all views", |ball, views| {
        views.iter().for_each(|view| drop(black_box(ball.prepare(view, Outputs::Colors))));
        Ok(())
    }),
    ("the same with derivatives", |ball, views| {
        views.iter().for_each(|view| drop(black_box(ball.prepare(view, Outputs::Derivatives))));
        Ok(())
    }),
    ("the same, and the splats of a quarter of the pixels", hits),
    ("the samples of 4,096,000 rays", |ball, views| {
        let lattice = Lattice::from_domain(domain(), LEVEL)?;
        let stream = RaySettings::default().rays(RAYS).stream(ball.splats(), views, &lattice, &Silent)?;
        stream.run(Shard::whole(RAYS), RunProgress::default(), &Silent, |_, _| Ok(())).map(|_| ())
    }),
    ("a run of 4,096,000 rays", run),
];

type Part = fn(&SplatRenderer, &[Camera]) -> Result<()>;

pub fn table(work: &Work) -> Result<String> {
    let (splats, views) = (ball(SPLATS), cameras(VIEWS));
    let renderer = SplatRenderer::new(&splats, Vec3::ONE);
    let mut table = Table::new(&["part", "processor seconds", "seconds"]);
    for (name, part) in PARTS {
        let Time { cpu, wall } = work.row(name, || {
            let clock = Clock::start();
            part(&renderer, &views)?;
            Ok(clock.elapsed())
        })?;
        table.row(&[name.to_string(), format!("{cpu:.1}"), format!("{wall:.1}")]);
    }
    Ok(table.text().into())
}

fn domain() -> Domain {
    Domain::Box(Aabb::centered_cube(1.1))
}

/// The splats of every second pixel along x and y, by one thread.
fn hits(ball: &SplatRenderer, views: &[Camera]) -> Result<()> {
    let (mut hits, mut count) = (Hits::default(), 0);
    for camera in views {
        let view = ball.prepare(camera, Outputs::Derivatives);
        for y in (0..camera.resolution[1]).step_by(2) {
            for x in (0..camera.resolution[0]).step_by(2) {
                view.hits([x, y].map(|i| f64::from(i) + 0.5), &mut hits);
                count += hits.list.len();
            }
        }
    }
    black_box(count);
    Ok(())
}

fn run(ball: &SplatRenderer, views: &[Camera]) -> Result<()> {
    let run = Estimation::new(ball.splats(), views).domain(domain());
    let run = run.rays(RaySettings::default().rays(RAYS)).grid(GridSettings::default().level(LEVEL));
    black_box(run.run()?.progress.samples);
    Ok(())
}
