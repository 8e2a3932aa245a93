//! Execution without the GIL, with Ctrl-C and progress reports.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::base::errors::KernelError;
use crate::base::parallel::spawn_if_possible;
use crate::base::progress::{Progress, RunControl};

/// Interval of the checks for Ctrl-C, and number of checks per progress report.
const CHECK_INTERVAL: Duration = Duration::from_millis(40);
const CHECKS_PER_REPORT: u32 = 3;

/// Run `work` without the GIL on a separate thread, and wait for it. `progress(done, total)`, a Python
/// function, is called regularly if given. An exception there, or Ctrl-C, aborts the work and is raised here.
/// If it returns False, the work stops and returns its result so far; with `partial`, Ctrl-C has the same
/// effect. A panic becomes a RuntimeError.
pub fn run_detached<R: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    partial: bool,
    work: impl FnOnce(&mut Progress) -> Result<R, KernelError> + Send,
) -> PyResult<R> {
    let (mut work, mut result) = (Some(work), None);
    watch_thread(py, progress, partial, &mut |progress| result = work.take().map(|work| work(progress)))?;
    match result {
        Some(result) => result.map_err(PyErr::from),
        None => Err(KernelError::OutOfMemory.into()),
    }
}

/// Run `work` on a separate thread and wait for it, as [`run_detached`] says. Without type parameters, so that
/// it is compiled only once.
///
/// Returns without having called `work` if no thread is available.
fn watch_thread(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    partial: bool,
    work: &mut (dyn FnMut(&mut Progress) + Send),
) -> PyResult<()> {
    let control = RunControl::default();
    let mut raised: Option<PyErr> = None;
    let outcome = py.detach(|| {
        std::thread::scope(|scope| {
            let (ended, end) = std::sync::mpsc::channel();
            let control = &control;
            let worker = spawn_if_possible(scope, move || {
                let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut Progress::new(control))));
                // The receiver does not wait any more after an exception.
                let _ = ended.send(());
                outcome
            })?;
            let mut looks = 0;
            while end.recv_timeout(CHECK_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                looks += 1;
                let looked = Python::attach(|py| {
                    if let Err(interrupt) = py.check_signals() {
                        if !partial {
                            return Err(interrupt);
                        }
                        control.stop_early();
                    }
                    if let Some(progress) = progress.filter(|_| looks % CHECKS_PER_REPORT == 0) {
                        let (done, total) = control.units_done();
                        if progress.call1(py, (done, total))?.bind(py).is(PyBool::new(py, false)) {
                            control.stop_early();
                        }
                    }
                    Ok(())
                });
                if let Err(error) = looked {
                    raised = Some(error);
                    control.abort();
                    break;
                }
            }
            Some(worker.join())
        })
    });
    if let Some(error) = raised {
        return Err(error);
    }
    match outcome {
        None | Some(Ok(Ok(()))) => Ok(()),
        _ => Err(PyRuntimeError::new_err(
            "internal error in the mesh kernels; please report it with the mesh that causes it",
        )),
    }
}
