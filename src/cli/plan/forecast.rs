//! What a run is expected to need.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::Result;
use crate::cli::report;
use crate::estimate::{Plan, Run};

/// What a process is expected to need.
#[derive(Debug, Clone, Copy)]
pub struct Forecast {
    pub rays: u64,
    pub vertices: f64,
    /// Largest memory of the process, bytes.
    pub peak: f64,
    /// Size of the field's file, bytes.
    pub file: f64,
    pub time: Duration,
}

impl Forecast {
    /// Forecasts a run that was prepared since `start`: with its plan.
    pub fn of(run: &Run, start: Instant) -> Result<(Self, Plan)> {
        let plan = run.forecast()?;
        // The pilot's time belongs to the run as well, which makes one of its own.
        let time = plan.time + start.elapsed();
        let forecast = Self { rays: run.rays(), vertices: plan.vertices, peak: plan.peak(), file: plan.file, time };
        Ok((forecast, plan))
    }

    /// The same on another number of CPUs than here.
    pub fn on(self, cpus: u16) -> Self {
        let time = self.time.mul_f64(rayon::current_num_threads() as f64 / f64::from(cpus));
        Self { time, ..self }
    }

    /// Memory and time in words.
    pub fn cost(&self) -> String {
        format!("{} of memory, {:.0} s", report::bytes(self.peak as usize), self.time.as_secs_f64().ceil())
    }

    pub fn json(&self) -> Value {
        json!({
            "rays": self.rays,
            "vertices": self.vertices.round(),
            "peak_bytes": self.peak.round(),
            "file_bytes": self.file.round(),
            "seconds": self.time.as_secs_f64(),
        })
    }
}
