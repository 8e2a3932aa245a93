//! Telling the caller now and then how far the work is, and asking whether to go on.

use std::time::{Duration, Instant};

use crate::error::KernelError;

const PERIOD: Duration = Duration::from_millis(100);
/// Ticks between two looks at the clock.
const STRIDE: u32 = 256;

/// Calls back about ten times a second, whatever the rate of ticks.
pub struct Progress<'a> {
    go_on: &'a mut dyn FnMut(u64, u64) -> bool,
    ticks: u32,
    last: Instant,
}

impl<'a> Progress<'a> {
    /// `go_on(done, total)` returns false to stop the work.
    pub fn new(go_on: &'a mut dyn FnMut(u64, u64) -> bool) -> Self {
        Self { go_on, ticks: 0, last: Instant::now() }
    }

    /// # Errors
    /// [`KernelError::Interrupted`] when the caller wants to stop.
    #[inline]
    pub fn tick(&mut self, done: impl FnOnce() -> (u64, u64)) -> Result<(), KernelError> {
        self.ticks += 1;
        if self.ticks < STRIDE {
            return Ok(());
        }
        self.ticks = 0;
        if self.last.elapsed() < PERIOD {
            return Ok(());
        }
        let (done, total) = done();
        self.tell(done, total)
    }

    /// Call back now, between two phases of the work.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when the caller wants to stop.
    pub fn tell(&mut self, done: u64, total: u64) -> Result<(), KernelError> {
        self.last = Instant::now();
        if (self.go_on)(done, total) { Ok(()) } else { Err(KernelError::Interrupted) }
    }
}
