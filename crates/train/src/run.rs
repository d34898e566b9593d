//! A whole training run, limited by steps or by time, with repeated checks on held-out images.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::Vec3;
use serde::Serialize;

use super::{Background, Quality, Selection, Shot};
use octobayes::Result;
use octobayes::geometry::Domain;
use octobayes::monitor::Monitor;
use octobayes_data::Views;

/// End of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Budget {
    /// After this many steps; the result is the same every time.
    Steps(u64),
    /// After this time. The number of steps, and with it the result, depends on the machine.
    Time(Duration),
}

/// Steps between two reports of the loss. The clock and Ctrl-C are checked at every step.
const REPORT: u64 = 16;
/// Share of the training time that a run limited by time may spend on looking at held-out images.
const LOOKING: f64 = 0.1;

/// A model in training, of either kind.
pub trait Training {
    /// Number of steps so far.
    fn steps(&self) -> u64;

    /// Takes one step when `share` (0 to 1) of the run is done. Returns the loss and the mean squared error of the
    /// colours, from before it changed the model.
    ///
    /// # Errors
    /// If the loss, or a parameter that is quickly looked at, is not finite any more.
    fn advance(&mut self, share: f64) -> Result<[f64; 2]>;

    /// Looks at all parameters.
    ///
    /// # Errors
    /// If some are not finite any more.
    fn check(&self) -> Result<()>;

    /// Saves the run under a description; `elapsed` is its time so far in seconds.
    ///
    /// # Errors
    /// If the file cannot be written.
    fn save(&self, path: &Path, key: &str, elapsed: f64) -> Result<()>;

    /// Quality on images, of which about so many pixels are compared, and fewer if that takes longer than `within`.
    fn look(&self, shots: &[Shot], pixels: usize, within: Option<Duration>) -> Option<Quality>;
}

/// Progress of a run while it is going on.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Number of steps so far.
    pub steps: u64,
    /// Share of the run that is done, in `[0, 1]`.
    pub share: f64,
    /// Mean loss of a ray since the last report.
    pub loss: f64,
    /// PSNR on training rays since the last report, dB.
    pub train_psnr: f64,
    /// Quality on held-out images, if it was just measured.
    pub held_out: Option<Quality>,
    /// Time left, in seconds.
    pub left: f64,
}

/// Where and how often a run saves its state.
#[derive(Debug, Clone)]
pub struct StateFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Description that a resumed run must share with the saved one.
    pub key: String,
    /// Time between two saves.
    pub every: Duration,
}

impl StateFile {
    /// Time between two saves on the command line.
    pub const EVERY: Duration = Duration::from_secs(60);
}

/// A training run with its limits.
pub struct Run<'a> {
    /// When it ends.
    pub budget: Budget,
    /// Images to measure its quality on.
    pub held_out: &'a [Shot],
    /// Number of their pixels that are compared during the run.
    pub pixels: usize,
    /// Number of parts into which these measurements divide the run. There is none at its end.
    pub looks: u32,
    /// Where the state is saved, if at all.
    pub state: Option<StateFile>,
}

/// Outcome of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finished {
    /// Seconds of training, including those before an interruption, without the time for measuring quality.
    pub elapsed: f64,
    /// True if the user stopped it.
    pub interrupted: bool,
}

impl Run<'_> {
    /// Trains until the budget is spent or the user interrupts. `elapsed` seconds of it are already spent.
    ///
    /// # Errors
    /// If loss or parameters are not finite any more, or if the state cannot be saved.
    pub fn train(
        &self,
        trainer: &mut impl Training,
        elapsed: f64,
        monitor: &dyn Monitor,
        mut report: impl FnMut(&Progress),
    ) -> Result<Finished> {
        let mut clock = Clock { before: elapsed, start: Instant::now(), paused: 0.0 };
        let mut saved = Instant::now();
        let (mut loss, mut error, mut count) = (0.0, 0.0, 0_u64);
        // Seconds spent on looking at held-out images.
        let mut looked = 0.0;
        let first_share = self.share(trainer, elapsed);
        let mut next_look = (first_share * f64::from(self.looks)).floor() + 1.0;
        let interrupted = loop {
            let share = self.share(trainer, clock.elapsed());
            if share >= 1.0 || monitor.interrupted() {
                break share < 1.0;
            }
            let [step_loss, step_error] = trainer.advance(share)?;
            loss += step_loss;
            error += step_error;
            count += 1;
            let share = self.share(trainer, clock.elapsed());
            let due = share * f64::from(self.looks) >= next_look && share < 1.0;
            if due || trainer.steps().is_multiple_of(REPORT) {
                let pause = Instant::now();
                let mut held_out = None;
                if due {
                    next_look = (share * f64::from(self.looks)).floor() + 1.0;
                    held_out = self.look(trainer, LOOKING * clock.elapsed_until(pause) - looked);
                    looked += pause.elapsed().as_secs_f64();
                }
                let left = clock.elapsed_until(pause) - elapsed;
                let left = match self.budget {
                    Budget::Time(time) => time.as_secs_f64() - clock.elapsed_until(pause),
                    Budget::Steps(_) => left * (1.0 - share) / (share - first_share).max(1e-9),
                };
                let mean = |sum: f64| sum / count.max(1) as f64;
                report(&Progress {
                    steps: trainer.steps(),
                    share,
                    loss: mean(loss),
                    train_psnr: -10.0 * mean(error).log10(),
                    held_out,
                    left,
                });
                (loss, error, count) = (0.0, 0.0, 0);
                clock.paused += pause.elapsed().as_secs_f64();
            }
            if let Some(state) = self.state.as_ref().filter(|state| saved.elapsed() >= state.every) {
                trainer.check()?;
                trainer.save(&state.path, &state.key, clock.elapsed())?;
                saved = Instant::now();
            }
        };
        let elapsed = clock.elapsed();
        trainer.check()?;
        if let Some(state) = self.state.as_ref().filter(|_| interrupted) {
            trainer.save(&state.path, &state.key, elapsed)?;
        }
        Ok(Finished { elapsed, interrupted })
    }

    /// Quality on held-out images. A run that is limited by time looks no longer than `seconds`, or not at all.
    fn look(&self, trainer: &impl Training, seconds: f64) -> Option<Quality> {
        let within = match self.budget {
            Budget::Steps(_) => None,
            Budget::Time(_) => Some(Duration::try_from_secs_f64(seconds).ok()?),
        };
        trainer.look(self.held_out, self.pixels, within)
    }

    fn share(&self, trainer: &impl Training, elapsed: f64) -> f64 {
        match self.budget {
            Budget::Steps(steps) => (trainer.steps() as f64 / steps.max(1) as f64).min(1.0),
            Budget::Time(time) => (elapsed / time.as_secs_f64().max(1e-9)).min(1.0),
        }
    }
}

/// Clock for the time spent on training alone.
struct Clock {
    before: f64,
    start: Instant,
    paused: f64,
}

impl Clock {
    fn elapsed(&self) -> f64 {
        self.elapsed_until(Instant::now())
    }

    fn elapsed_until(&self, now: Instant) -> f64 {
        self.before + now.duration_since(self.start).as_secs_f64() - self.paused
    }
}

impl Background {
    /// Background to show images on: white if training used random colours.
    #[must_use]
    pub fn for_images(self) -> Vec3 {
        match self {
            Self::Random => Vec3::ONE,
            Self::Fixed(color) => Vec3::from_array(color),
        }
    }
}

/// Origin of a run. The model's file records it, and a resumed run must share it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Description<S = super::TrainSettings> {
    /// Version of this crate. Other versions may round or draw differently.
    pub version: &'static str,
    /// Path of the camera file.
    pub dataset: String,
    /// Checksum of the camera file.
    pub cameras: u32,
    /// Selection of training images.
    pub views: Selection,
    /// Number of training images.
    pub images: usize,
    /// Checksum of their pixels and masks ([`Shot::checksum`](super::Shot::checksum)).
    pub pictures: u32,
    /// All other settings.
    pub settings: S,
    /// Space that the model covers.
    pub domain: Domain,
    /// Limit of the run, in steps or seconds.
    pub budget: String,
}

impl Description {
    /// Computes the checksum of a camera file.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn checksum(path: &Path) -> Result<u32> {
        let mut checksum = crc32fast::Hasher::new();
        for file in Views::files(path) {
            checksum.update(&octobayes::io::read(&file)?);
        }
        Ok(checksum.finalize())
    }
}
