//! Progress and cancellation, shared by the worker threads and the waiting thread.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::memory_reserve::shortage_count;

const RUNNING: u8 = 0;
const STOP_EARLY: u8 = 1;
const ABORT: u8 = 2;

/// Calls between two accesses of the shared atomics.
const CALLS_PER_REPORT: u32 = 256;

/// Shared state of one run. The waiting thread reads the progress and may stop the run.
#[derive(Debug)]
pub struct RunControl {
    signal: AtomicU8,
    done: AtomicU64,
    total: AtomicU64,
    /// Memory shortages counted before the run.
    shortages: u64,
}

impl Default for RunControl {
    fn default() -> Self {
        Self {
            signal: AtomicU8::new(RUNNING),
            done: AtomicU64::new(0),
            total: AtomicU64::new(0),
            shortages: shortage_count(),
        }
    }
}

impl RunControl {
    /// Abort the run: it ends with [`KernelError::Interrupted`].
    pub fn abort(&self) {
        self.signal.store(ABORT, Relaxed);
    }

    /// Ask the run to stop and return the result so far. [`RunControl::abort`] takes precedence.
    pub fn stop_early(&self) {
        let _ = self.signal.compare_exchange(RUNNING, STOP_EARLY, Relaxed, Relaxed);
    }

    /// Return (done, total) units of work. Both never decrease between calls, and done never exceeds total.
    pub fn units_done(&self) -> (u64, u64) {
        let done = self.done.load(Relaxed);
        let total = self.total.load(Relaxed);
        (done.min(total), total)
    }
}

/// Handle of one thread on the shared control.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    control: &'a RunControl,
    ticks: u32,
    scope: ProgressScope,
}

/// Relation between the units of a handle and the reported progress.
#[derive(Clone, Copy, Debug)]
enum ProgressScope {
    All,
    /// Units before this part, and in total.
    Part(u64, u64),
    /// Nothing is reported.
    Silent,
}

impl<'a> Progress<'a> {
    /// Create a handle for the whole run.
    pub fn new(control: &'a RunControl) -> Self {
        Self { control, ticks: 0, scope: ProgressScope::All }
    }

    /// Create a handle for a part of the work that starts after `before` of `total` units.
    pub fn for_part(&self, before: u64, total: u64) -> Self {
        Self { scope: ProgressScope::Part(before, total), ..self.clone() }
    }

    /// Create a handle for work counted in other units: it reports nothing, and only checks for cancellation.
    pub fn silent(&self) -> Self {
        Self { scope: ProgressScope::Silent, ..self.clone() }
    }

    /// Every [`CALLS_PER_REPORT`] calls, report the progress and check for cancellation.
    #[inline]
    pub fn report_periodically(&mut self, done: impl FnOnce() -> (u64, u64)) -> Result<(), KernelError> {
        self.ticks += 1;
        if self.ticks < CALLS_PER_REPORT {
            return Ok(());
        }
        self.ticks = 0;
        let (done, total) = done();
        self.report(done, total)
    }

    /// Every [`CALLS_PER_REPORT`] calls, check for cancellation.
    #[inline]
    pub fn check_periodically(&mut self) -> Result<(), KernelError> {
        self.ticks += 1;
        if self.ticks < CALLS_PER_REPORT {
            return Ok(());
        }
        self.ticks = 0;
        self.check()
    }

    /// Report the progress and check for cancellation immediately, for example between two phases.
    pub fn report(&mut self, done: u64, total: u64) -> Result<(), KernelError> {
        let (done, total) = match self.scope {
            ProgressScope::All => (done, total),
            ProgressScope::Part(before, all) => (before + done, all),
            ProgressScope::Silent => return self.check(),
        };
        // Threads report in any order, and undone work is repeated: the maximum keeps the progress bar
        // monotonic.
        self.control.total.fetch_max(total, Relaxed);
        self.control.done.fetch_max(done.min(total), Relaxed);
        self.check()
    }

    /// Check for cancellation and lack of memory.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] if the caller aborted the run; [`KernelError::OutOfMemory`] if the system
    /// had no memory since the run began, so that the work currently runs on the reserve.
    pub fn check(&self) -> Result<(), KernelError> {
        if self.control.signal.load(Relaxed) == ABORT {
            return Err(KernelError::Interrupted);
        }
        if shortage_count() == self.control.shortages { Ok(()) } else { Err(KernelError::OutOfMemory) }
    }

    /// Return true if the caller asked to stop and keep the result so far.
    #[inline]
    pub fn is_stopping_early(&self) -> bool {
        self.control.signal.load(Relaxed) == STOP_EARLY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_told_is_never_taken_back_nor_more_than_all() {
        let control = RunControl::default();
        let mut progress = Progress::new(&control);
        let told = [(3, 10), (2, 10), (12, 10), (1, 10)].map(|(done, total)| {
            progress.report(done, total).unwrap();
            control.units_done()
        });
        assert_eq!(told, [(3, 10), (3, 10), (10, 10), (10, 10)]);
    }

    #[test]
    fn parts_are_counted_where_they_stand_and_silent_work_not_at_all() {
        let control = RunControl::default();
        let progress = Progress::new(&control);
        progress.for_part(5, 20).report(3, 4).unwrap();
        progress.silent().report(90, 100).unwrap();
        assert_eq!(control.units_done(), (8, 20));
        control.abort();
        assert_eq!(progress.silent().report(1, 2), Err(KernelError::Interrupted));
    }
}
