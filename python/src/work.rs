//! Long work of the library, while Python stays responsive; and the one place that calls a field in Python.
//!
//! The work runs on threads of its own, which never hold the interpreter's lock. The thread that called from
//! Python waits for them, without the lock, and enters Python when there is something to do: to call the field, to look
//! for Ctrl-C, to report progress. So no thread of the work waits for the lock, and no thread that holds it waits for
//! the work: a callable may itself use this package, from any thread.
//!
//! Nothing outlives a call but the pool of [`crate::pool`], so that a forked child may begin work of its own.

use std::process;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArrayDyn};
use octobayes::field::{Differentiable, Radiance, RadianceField, RadianceJet, TrainedField};
use octobayes::geometry::Aabb;
use octobayes::glam::Vec3;
use octobayes::monitor::Monitor;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::errors::to_python;
use crate::pool;

/// Longest time between two looks at whether the user pressed Ctrl-C.
const TICK: Duration = Duration::from_millis(50);
/// Least time between two reports of progress.
const REPORT: Duration = Duration::from_millis(100);

/// The method of `octobayes._gate.Gate` to call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Density,
    Radiance,
    Derivatives,
}

/// Arrays in row-major order, as the kind has them: density, colour, ∇ density, ∇ colour (channel, then axis).
type Answer = [Vec<f32>; 4];

struct Question {
    kind: Kind,
    positions: Vec<f32>,
    directions: Vec<f32>,
    reply: SyncSender<Option<Answer>>,
}

enum Message {
    Ask(Question),
    Done,
}

/// The stage of the work.
#[derive(Debug, Clone, Default, PartialEq)]
struct Stage {
    name: String,
    total: u64,
    /// Counts the stages.
    number: u64,
}

/// What the work and the thread that waits for it share.
#[derive(Default)]
struct Shared {
    stopped: AtomicBool,
    done: AtomicU64,
    stage: Mutex<Stage>,
}

impl Monitor for Shared {
    fn begin(&self, stage: &str, total: u64) {
        let mut now = self.stage.lock().unwrap_or_else(PoisonError::into_inner);
        *now = Stage { name: stage.into(), total, number: now.number + 1 };
        self.done.store(0, Ordering::Relaxed);
    }

    fn advance(&self, units: u64) {
        self.done.fetch_add(units, Ordering::Relaxed);
    }

    fn end(&self) {}

    fn interrupted(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }
}

/// Properties of a field in Python, read before the first call.
#[derive(Debug, Clone)]
pub struct Traits {
    pub bounds: Aabb,
    pub step: f64,
    pub batch: usize,
    pub pixel_offset: f64,
    pub has_density: bool,
    pub has_derivatives: bool,
    pub description: String,
}

/// Gives the work its monitor and its field.
pub struct Engine<'a> {
    shared: &'a Shared,
    link: Sender<Message>,
}

impl Engine<'_> {
    /// Progress, and whether to stop.
    pub fn monitor(&self) -> &dyn Monitor {
        self.shared
    }

    /// The field in Python that [`work`] got.
    pub fn field(&self, traits: Traits) -> PythonField<'_> {
        PythonField { traits, shared: self.shared, link: self.link.clone() }
    }
}

/// Says that the work is over, however it ended.
struct End(Sender<Message>);

impl Drop for End {
    fn drop(&mut self) {
        // The other side hangs up first only if it panicked.
        let _ = self.0.send(Message::Done);
    }
}

/// Does `job` on other threads. `gate` is the field in Python that it may call; `progress` is called with the name of
/// the stage, the units done and their total.
///
/// # Errors
/// What the field, `progress` or a signal handler raises, as they raised it; else what `job` returns.
pub fn work<T: Send>(
    py: Python<'_>,
    gate: Option<&Bound<'_, PyAny>>,
    progress: Option<&Bound<'_, PyAny>>,
    job: impl FnOnce(&Engine) -> octobayes::Result<T> + Send,
) -> PyResult<T> {
    // Threads of the common pool must not wait for Python: Python may wait for them.
    let (pool, process) = (pool::build()?, process::id());
    let (link, inbox) = mpsc::channel();
    let (shared, inbox) = (Shared::default(), Mutex::new(inbox));
    thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let engine = Engine { shared: &shared, link };
            let _end = End(engine.link.clone());
            pool.install(|| job(&engine))
        });
        let failure = attend(py, gate, progress, &shared, &inbox, process).err();
        if process::id() != process {
            end_child(py, failure);
        }
        let outcome = py.detach(|| worker.join());
        match (failure, outcome) {
            // What was raised caused whatever else went wrong.
            (Some(failure), _) => Err(failure),
            (None, Ok(outcome)) => outcome.map_err(to_python),
            (None, Err(panic)) => std::panic::resume_unwind(panic),
        }
    })
}

/// Stops the work after an exception: before anybody is answered, so that nobody goes on with what was not computed.
fn stop_unless(result: PyResult<()>, shared: &Shared) -> PyResult<()> {
    if result.is_err() {
        shared.stopped.store(true, Ordering::SeqCst);
    }
    result
}

/// Ends a child that was forked by the callable, or by the callback for progress, and came back from there: the threads
/// that do the work, and that would end it, are its parent's.
fn end_child(py: Python<'_>, failure: Option<PyErr>) -> ! {
    let error = failure.unwrap_or_else(|| {
        PyRuntimeError::new_err(
            "octobayes: expected a callable that ends the processes that it forks (os._exit), found a forked child \
             that goes on with its parent's work; start it with the method spawn or forkserver of multiprocessing",
        )
    });
    // Of SystemExit, this is the end.
    error.print(py);
    let _ = py.import("os").and_then(|os| os.call_method1("_exit", (1,)));
    process::abort()
}

/// Answers until the work is over, or no longer this `process`'s. After the first exception everything is answered
/// with "none".
fn attend(
    py: Python<'_>,
    gate: Option<&Bound<'_, PyAny>>,
    progress: Option<&Bound<'_, PyAny>>,
    shared: &Shared,
    inbox: &Mutex<Receiver<Message>>,
    process: u32,
) -> PyResult<()> {
    let next = || inbox.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(TICK);
    let mut result = Ok(());
    let mut reporter = Reporter { progress, seen: Stage::default(), done: 0, last: Instant::now() };
    loop {
        if process::id() != process {
            return result;
        }
        let message = py.detach(next);
        if result.is_ok() {
            result = stop_unless(py.check_signals(), shared);
        }
        match message {
            Ok(Message::Done) | Err(RecvTimeoutError::Disconnected) => break,
            Ok(Message::Ask(question)) => {
                let mut answer = None;
                if result.is_ok() {
                    result =
                        ask(gate, question.kind, question.positions, question.directions).map(|found| answer = found);
                    result = stop_unless(result, shared);
                }
                // The caller waits for this; it is gone only after a panic.
                let _ = question.reply.send(answer);
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
        if result.is_ok() {
            result = stop_unless(reporter.report(shared, false), shared);
        }
    }
    result?;
    reporter.report(shared, true)
}

/// Asks the field in Python.
fn ask(
    gate: Option<&Bound<'_, PyAny>>,
    kind: Kind,
    positions: Vec<f32>,
    directions: Vec<f32>,
) -> PyResult<Option<Answer>> {
    let Some(gate) = gate else { return Ok(None) };
    let py = gate.py();
    let rows = |values: Vec<f32>| {
        let n = values.len() / 3;
        PyArray1::from_vec(py, values).reshape([n, 3])
    };
    let floats = |array: &Bound<'_, PyAny>| -> PyResult<Vec<f32>> {
        Ok(array.extract::<PyReadonlyArrayDyn<f32>>()?.as_slice()?.to_vec())
    };
    let positions = rows(positions)?;
    let answer = match kind {
        Kind::Density => {
            let density = gate.call_method1("density", (positions,))?;
            [floats(&density)?, Vec::new(), Vec::new(), Vec::new()]
        }
        Kind::Radiance => {
            let answer = gate.call_method1("radiance", (positions, rows(directions)?))?;
            [floats(&answer.get_item(0)?)?, floats(&answer.get_item(1)?)?, Vec::new(), Vec::new()]
        }
        Kind::Derivatives => {
            let answer = gate.call_method1("derivatives", (positions, rows(directions)?))?;
            let part = |i: usize| floats(&answer.get_item(i)?);
            [part(0)?, part(1)?, part(2)?, part(3)?]
        }
    };
    Ok(Some(answer))
}

/// Calls the callback for progress, but not too often.
struct Reporter<'a, 'py> {
    progress: Option<&'a Bound<'py, PyAny>>,
    seen: Stage,
    done: u64,
    last: Instant,
}

impl Reporter<'_, '_> {
    fn report(&mut self, shared: &Shared, is_last: bool) -> PyResult<()> {
        let Some(progress) = self.progress else { return Ok(()) };
        if !is_last && self.last.elapsed() < REPORT {
            return Ok(());
        }
        let stage = shared.stage.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // Some stages are coarser than they say.
        let done = shared.done.load(Ordering::Relaxed).min(stage.total);
        if stage.number > 0 && (stage != self.seen || done != self.done) {
            progress.call1((stage.name.as_str(), done, stage.total))?;
            (self.seen, self.done) = (stage, done);
        }
        self.last = Instant::now();
        Ok(())
    }
}

/// A field in Python, called by message.
pub struct PythonField<'a> {
    traits: Traits,
    shared: &'a Shared,
    link: Sender<Message>,
}

/// Points that a thread copies at a time. Copying is done by all threads, because all wait for it.
const COPIED: usize = 1 << 13;

fn flat(points: &[Vec3]) -> Vec<f32> {
    points.par_iter().with_min_len(COPIED).map(Vec3::to_array).collect::<Vec<_>>().into_flattened()
}

impl PythonField<'_> {
    /// Asks about all points, in parts of at least `batch` and less than twice as many, and passes `read` where each
    /// part begins and what its answer is. After an exception there are no answers: the run is about to end.
    fn ask(&self, kind: Kind, positions: &[Vec3], directions: &[Vec3], mut read: impl FnMut(usize, Answer)) {
        let n = positions.len();
        let parts = (n / self.traits.batch.max(1)).max(1);
        for part in 0..parts {
            let (from, to) = (part * n / parts, (part + 1) * n / parts);
            if from == to || self.shared.interrupted() {
                return;
            }
            let directions = if directions.is_empty() { Vec::new() } else { flat(&directions[from..to]) };
            let (reply, answer) = mpsc::sync_channel(1);
            let question = Question { kind, positions: flat(&positions[from..to]), directions, reply };
            if self.link.send(Message::Ask(question)).is_err() {
                return;
            }
            if let Ok(Some(answer)) = answer.recv() {
                read(from, answer);
            }
        }
    }
}

impl RadianceField for PythonField<'_> {
    fn bounds(&self) -> Aabb {
        self.traits.bounds
    }

    fn evaluate(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [Radiance]) {
        self.ask(Kind::Radiance, positions, directions, |from, [density, color, ..]| {
            let answers = density.par_iter().zip(color.as_chunks::<3>().0);
            out[from..].par_iter_mut().zip(answers).with_min_len(COPIED).for_each(|(out, (density, color))| {
                *out = Radiance { density: *density, color: Vec3::from_array(*color) };
            });
        });
    }

    fn densities(&self, positions: &[Vec3], out: &mut [f32]) {
        if self.traits.has_density {
            self.ask(Kind::Density, positions, &[], |from, [density, ..]| {
                out[from..from + density.len()].copy_from_slice(&density);
            });
        } else {
            let directions = vec![Vec3::Z; positions.len()];
            self.ask(Kind::Radiance, positions, &directions, |from, [density, ..]| {
                out[from..from + density.len()].copy_from_slice(&density);
            });
        }
    }

    fn differentiable(&self) -> Option<&dyn Differentiable> {
        self.traits.has_derivatives.then_some(self)
    }

    fn suggested_step(&self) -> f64 {
        self.traits.step
    }

    fn batch(&self) -> usize {
        self.traits.batch
    }
}

impl TrainedField for PythonField<'_> {
    fn pixel_offset(&self) -> f64 {
        self.traits.pixel_offset
    }

    fn describe(&self) -> String {
        self.traits.description.clone()
    }
}

impl Differentiable for PythonField<'_> {
    fn jets(&self, positions: &[Vec3], directions: &[Vec3], out: &mut [RadianceJet]) {
        self.ask(Kind::Derivatives, positions, directions, |from, [density, color, slope, color_gradient]| {
            let values = density.par_iter().zip(color.as_chunks::<3>().0);
            let slopes = slope.as_chunks::<3>().0.par_iter().zip(color_gradient.as_chunks::<9>().0);
            let jets = out[from..].par_iter_mut().zip(values.zip(slopes)).with_min_len(COPIED);
            jets.for_each(|(out, ((density, color), (slope, color_gradient)))| {
                // Python's rows are channels; a jet has one colour for each axis.
                let gradient =
                    |axis: usize| Vec3::new(color_gradient[axis], color_gradient[3 + axis], color_gradient[6 + axis]);
                *out = RadianceJet {
                    value: Radiance { density: *density, color: Vec3::from_array(*color) },
                    density_gradient: Vec3::from_array(*slope),
                    color_gradients: [0, 1, 2].map(gradient),
                };
            });
        });
    }
}
