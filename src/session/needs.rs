//! What a run will need, before its first ray.

use std::path::Path;

use super::Prepared;
use super::memory::{available, bytes};
use crate::estimate::{ErrorBudget, Plan, Planner};
use crate::io::memory::resident;
use crate::{Error, Result};

/// Report the size of a file before the run if it has more bytes than this.
const LARGE_FILE: f64 = 5e7;

/// Refuses a folder with less room than sums on disk will take.
fn check_space(folder: &Path, needed: f64, free: u64) -> Result<()> {
    if needed <= free as f64 {
        return Ok(());
    }
    let expected = format!(
        "{} for sums on disk by a pilot of the run; a larger --memory needs less, --scratch or --checkpoint choose \
         another folder",
        bytes(needed as usize)
    );
    Err(Error::setting(format!("folder {}", folder.display()), expected, format!("{} free", bytes(free as usize))))
}

/// What a run will need.
#[derive(Debug, Clone, serde::Serialize)]
#[non_exhaustive]
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
    /// What the run will need, by a pilot of a few thousand rays.
    ///
    /// # Errors
    /// As [`Run::forecast`](crate::estimate::Run::forecast).
    pub fn needs(&self) -> Result<Needs> {
        let plan = self.run.forecast()?;
        // The pilot's time belongs to the run as well, which makes one of its own.
        let seconds = (plan.time + self.start.elapsed()).as_secs_f64();
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

    /// Predicts what the run will need, if it is long, has limits or makes a large file.
    ///
    /// # Errors
    /// If that is more memory or disk space than there is, or as [`Prepared::needs`].
    pub fn forecast(&self) -> Result<Option<Plan>> {
        if !self.has_fixed_rays() {
            return Ok(None);
        }
        let plan = match self.run.forecast() {
            // Of the few rays of a pilot, too many may be at fault by chance; the run will count them.
            Err(Error::NonFinite { .. }) => return Ok(None),
            plan => plan?,
        };
        let left = available().zip(resident()).map(|(available, resident)| (available + resident) as f64);
        if let Some(left) = left.filter(|left| plan.peak() > *left) {
            let bound = if self.grid.memory.is_none() { "--memory bounds it, " } else { "" };
            let expected = format!(
                "{}, the peak of the process by a pilot of the run; {bound}a lower --level or --refine ray-count need \
                 less",
                bytes(plan.peak() as usize)
            );
            return Err(Error::setting("memory", expected, format!("{} free", bytes(left as usize))));
        }
        if let Some((folder, taken)) = self.run.scratch()
            && let Ok(free) = fs4::available_space(&folder)
        {
            check_space(&folder, plan.disk, free + taken)?;
        }
        let is_notable =
            self.grid.is_limited() || self.run.rays() >= Planner::CHEAP * Planner::PILOT || plan.file > LARGE_FILE;
        Ok(is_notable.then_some(plan))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_too_little_room_is_refused_before_the_run() {
        let folder = Path::new("scratch");
        assert!(check_space(folder, 4.7e9, 4_700_000_000).is_ok() && check_space(folder, 0.0, 0).is_ok());
        let error = check_space(folder, 4.7e9, 1_200_000_000).unwrap_err().to_string();
        for part in ["folder scratch", "4.70 GB", "1.20 GB free", "--scratch", "--memory"] {
            assert!(error.contains(part), "{error}");
        }
    }
}
