//! Some more steps for splats that were trained before.

use glam::DVec3;

use super::SplatSettings;
use super::trainer::SplatTrainer;
use crate::{Shot, Training};
use octobayes::monitor::{Monitor, check};
use octobayes::{Error, Result};
use octobayes_splats::{RenderMode, Splats};

/// Part of a run that counts as done: after it no splat is added or removed, and centres hardly move.
const DONE: f64 = 0.7;
/// Pixels of images that are compared before and after.
const LOOK: usize = 2_000_000;

/// Splats after some more steps.
#[derive(Debug, Clone)]
pub struct Refitted {
    /// As many splats, in the same order, with all that the file had beside the parameters.
    pub splats: Splats,
    /// Mean PSNR of training images before and after, dB; not of images that are masked altogether.
    pub psnr: Option<[f64; 2]>,
}

/// Refuses splats that are drawn in another way than they are trained here.
///
/// # Errors
/// If they are.
pub fn check_mode(splats: &Splats) -> Result<()> {
    if splats.mode() == RenderMode::Classic {
        return Ok(());
    }
    let expected = format!("splats that are drawn as `{}`, as they are trained here", RenderMode::Classic);
    Err(Error::setting("--refit", expected, format!("`{}`", splats.mode())))
}

/// Trains splats further, at the rates of the end of a run: none is added, none is removed, and they stay nearly where
/// they are. The number in `settings` of most splats does not count.
///
/// # Errors
/// If the splats are antialiased, which the trainer does not draw, as [`SplatTrainer::check_cameras`], if the loss is not
/// finite any more, or [`Error::Interrupted`].
///
/// # Panics
/// If there are no shots.
pub fn refit(
    splats: &Splats,
    shots: &[Shot],
    settings: SplatSettings,
    steps: u64,
    monitor: &dyn Monitor,
) -> Result<Refitted> {
    check_mode(splats)?;
    let extent = 0.5 * splats.main_box().longest_edge();
    let mut trainer = SplatTrainer::from_splats(settings, extent.min(spread(shots)), splats, shots)?;
    let before = trainer.look(shots, LOOK, None);
    monitor.begin("steps", steps);
    for step in 0..steps {
        check(monitor)?;
        trainer.advance(DONE + (1.0 - DONE) * step as f64 / steps as f64)?;
        monitor.advance(1);
    }
    monitor.end();
    trainer.check()?;
    let psnr = before.zip(trainer.look(shots, LOOK, None)).map(|(before, after)| [before.psnr, after.psnr]);
    Ok(Refitted { splats: trainer.splats()?.with_layout_of(splats), psnr })
}

/// How far the cameras stand from their middle at most, and a tenth more, scene units: what the original code takes for
/// the size of a scene. Its splats reach much farther where there is a background. Infinite for a single camera.
fn spread(shots: &[Shot]) -> f64 {
    let middle = shots.iter().map(|shot| shot.camera.position).sum::<DVec3>() / shots.len() as f64;
    let most = shots.iter().map(|shot| shot.camera.position.distance(middle)).fold(0.0, f64::max);
    if most > 0.0 { 1.1 * most } else { f64::INFINITY }
}
