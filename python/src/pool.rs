//! Where work runs that never enters Python: a pool of threads that belongs to the current process.
//!
//! `fork()` copies the thread that calls it and no other. A child that hands work to threads of its parent, such as
//! those of rayon's common pool, waits for ever. So nothing in this package uses the common pool: short work runs here,
//! in a pool that a child builds anew, and long work ([`crate::work`]) brings a pool for each call.

use std::sync::{Arc, Mutex, TryLockError};
use std::{mem, process};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// A pool, and the process whose threads it has.
struct Owned {
    process: u32,
    pool: Arc<ThreadPool>,
}

static POOL: Mutex<Option<Owned>> = Mutex::new(None);

/// A pool of `RAYON_NUM_THREADS` threads; without that variable, of one for each processor.
pub fn build() -> PyResult<ThreadPool> {
    let name = |i| format!("octobayes {i}");
    ThreadPoolBuilder::new().thread_name(name).build().map_err(|e| PyRuntimeError::new_err(e.to_string()))
}

/// The pool of this process.
fn own() -> PyResult<Arc<ThreadPool>> {
    let mut owned = match POOL.try_lock() {
        Ok(owned) => owned,
        Err(TryLockError::Poisoned(error)) => error.into_inner(),
        // Nobody waits: where a process was forked, the thread that holds the lock may not exist.
        Err(TryLockError::WouldBlock) => return build().map(Arc::new),
    };
    let process = process::id();
    if let Some(owned) = owned.as_ref().filter(|owned| owned.process == process) {
        return Ok(owned.pool.clone());
    }
    let pool = Arc::new(build()?);
    // A parent's pool is left as it is: to end its threads is to wait for them.
    mem::forget(owned.replace(Owned { process, pool: pool.clone() }));
    Ok(pool)
}

/// Does `job` on threads of this process, without the interpreter's lock. It must not enter Python.
///
/// # Errors
/// If the system has no threads left.
pub fn without_python<T: Send>(py: Python<'_>, job: impl FnOnce() -> T + Send) -> PyResult<T> {
    let pool = own()?;
    Ok(py.detach(|| pool.install(job)))
}
