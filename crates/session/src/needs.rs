//! What a run will need, by its first rays.

use std::path::{Path, PathBuf};

use super::Prepared;
use super::memory::{available, bytes};
use octobayes::estimate::{ErrorBudget, GridSettings, Plan, Run};
use octobayes::io::memory::resident;
use octobayes::monitor::Message;
use octobayes::{Error, Result};

/// Report the size of a file before the run if it has more bytes than this.
const LARGE_FILE: f64 = 5e7;

/// How many times the peak of a run its bound may be: 3.3 was found, of a model that few pixels show.
const LOOSEST: f64 = 3.5;
/// Report what a run takes if it has at least so many rays.
const MANY_RAYS: u64 = 1 << 19;

/// Compares a run's plan with what there is: refuses what there is no room for, and notes what a large run takes.
pub(super) struct Foresight {
    /// Finest level and number of rays.
    level: u8,
    rays: u64,
    is_bound: bool,
    /// The folder of sums on disk, if there is a budget.
    scratch: Option<PathBuf>,
}

impl Foresight {
    pub fn of(run: &Run, grid: &GridSettings) -> Self {
        Self { level: grid.level, rays: run.rays(), is_bound: grid.memory.is_some(), scratch: run.scratch() }
    }

    /// Looks at the plan.
    ///
    /// # Errors
    /// If the run takes more memory than there is, or may take more disk space.
    pub fn check(&self, plan: &Plan, tell: &mut dyn FnMut(Message)) -> Result<()> {
        let left = available().zip(resident()).map(|(available, resident)| (available + resident) as f64);
        if let Some(left) = left.filter(|left| plan.peak() > *left) {
            self.check_memory(plan.peak(), left, tell)?;
        }
        let free = self.scratch.as_ref().and_then(|folder| Some((folder, fs4::available_space(folder).ok()?)));
        if let Some((folder, free)) = free {
            check_space(folder, plan.disk, free)?;
        }
        if self.rays >= MANY_RAYS || plan.rays_per_vertex > 0.0 || plan.file > LARGE_FILE {
            tell(Message::Note(described(plan, self.level)));
        }
        Ok(())
    }

    /// Refuses a run whose peak exceeds what is left, or warns if it only may.
    fn check_memory(&self, peak: f64, left: f64, tell: &mut dyn FnMut(Message)) -> Result<()> {
        let bound = if self.is_bound { "" } else { "--memory bounds it, " };
        let expected = format!(
            "up to {}, the peak of the process by the run's first rays; {bound}a lower --level or --refine ray-count \
             need less",
            bytes(peak as usize)
        );
        let found = format!("{} free", bytes(left as usize));
        if peak > LOOSEST * left {
            return Err(Error::setting("memory", expected, found));
        }
        tell(Message::Warning(format!("the run may need more memory than there is: {expected}; {found}")));
        Ok(())
    }
}

/// Refuses a folder with less room than sums on disk may take.
fn check_space(folder: &Path, needed: f64, free: u64) -> Result<()> {
    if needed <= free as f64 {
        return Ok(());
    }
    let expected = format!(
        "up to {} for sums on disk by the run's first rays; a larger --memory needs less, --scratch or --checkpoint \
         choose another folder",
        bytes(needed as usize)
    );
    Err(Error::setting(format!("folder {}", folder.display()), expected, format!("{} free", bytes(free as usize))))
}

/// What a run takes, in words.
fn described(plan: &Plan, level: u8) -> String {
    let [peak, file, disk] = [plan.peak(), plan.file, plan.disk].map(|size| bytes(size as usize));
    let disk = if plan.disk > 0.0 { format!(", {disk} of sums on disk during the run") } else { String::new() };
    let given_up = given_up(plan).map_or(String::new(), |text| format!("; {text}"));
    format!(
        "by its first rays, level {level} takes at most {:.2e} vertices, {peak} at the peak of the process, a file of \
         {file}{disk}, and {:.0} s{given_up}",
        plan.vertices,
        plan.time.as_secs_f64().ceil()
    )
}

/// What leaves give up where rays are few, in words, if they do.
#[must_use]
pub fn given_up(plan: &Plan) -> Option<String> {
    let share = |(levels, share): (usize, &f64)| format!("{levels}: {:.1} %", 100.0 * share);
    let shares = plan.given_up.iter().enumerate().filter(|(_, share)| **share > 0.0);
    let shares: Vec<String> = shares.map(share).collect();
    // A larger leaf has the mean over a hat of twice the edge instead of the finest hat's value. H at surfaces grows
    // about eightfold, which is divided out. What is left is the variation of U within the larger hat.
    (plan.rays_per_vertex > 0.0).then(|| {
        format!(
            "leaves have {:.1} rays a vertex or are {} levels coarser; levels given up by share of what rays touch: {}",
            plan.rays_per_vertex,
            plan.given_up.len().saturating_sub(1),
            shares.join(", ")
        )
    })
}

/// What a run will need at most.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Needs {
    /// Number of rays.
    pub rays: u64,
    /// Finest level.
    pub level: u8,
    /// Number of vertices.
    pub vertices: f64,
    /// Rays per vertex below which leaves stay coarser; 0 without limits.
    pub rays_per_vertex: f64,
    /// Peak memory of the process, bytes.
    pub peak_bytes: f64,
    /// Size of the sums that leave memory, bytes on disk.
    pub disk_bytes: f64,
    /// Size of the file, bytes.
    pub file_bytes: f64,
    /// Time of the run, its checks included.
    pub seconds: f64,
    /// Number of threads.
    pub threads: usize,
    /// How far log10 U will be from its limit, as far as that is known.
    pub errors: ErrorBudget,
    /// All that was predicted.
    #[serde(skip)]
    pub plan: Plan,
}

impl Prepared<'_> {
    /// What the run will need at most, by its first rays.
    ///
    /// # Errors
    /// As [`Run::forecast`](octobayes::estimate::Run::forecast).
    pub fn needs(&self) -> Result<Needs> {
        let before = self.start.elapsed();
        let plan = self.run.forecast()?;
        let seconds = (plan.time + before).as_secs_f64();
        Ok(Needs {
            rays: self.run.rays(),
            level: self.grid.level,
            vertices: plan.vertices.round(),
            rays_per_vertex: plan.rays_per_vertex,
            peak_bytes: plan.peak().round(),
            disk_bytes: plan.disk.round(),
            file_bytes: plan.file.round(),
            seconds,
            threads: rayon::current_num_threads(),
            errors: self.known_errors(),
            plan,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_refused_if_it_takes_more_memory_than_there_is_and_warned_of_if_it_may() {
        let foresight = Foresight { level: 9, rays: 1000, is_bound: false, scratch: None };
        let check = |peak: f64| {
            let mut said = Vec::new();
            let result = foresight.check_memory(peak, 1e9, &mut |message| said.push(message.to_string()));
            (result.err().map(|error| error.to_string()), said.concat())
        };
        let (error, said) = check(2e9);
        assert!(error.is_none() && ["2.00 GB", "1.00 GB free", "--memory"].iter().all(|part| said.contains(part)));
        let (error, said) = check(4e9);
        assert!(said.is_empty() && error.is_some_and(|error| error.contains("4.00 GB")));
    }

    #[test]
    fn a_folder_with_too_little_room_is_refused_before_the_run() {
        let folder = Path::new("scratch");
        assert!(check_space(folder, 4.7e9, 4_700_000_000).is_ok() && check_space(folder, 0.0, 0).is_ok());
        let error = check_space(folder, 4.7e9, 1_200_000_000).unwrap_err().to_string();
        for part in ["folder scratch", "up to 4.70 GB", "1.20 GB free", "--scratch", "--memory"] {
            assert!(error.contains(part), "{error}");
        }
    }
}
