//! How far the work is, and whether to go on: what the threads at work share with the one that waits for them.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::reserve::shortages;

const GO_ON: u8 = 0;
const ENOUGH: u8 = 1;
const ABORT: u8 = 2;

/// Ticks between two looks at the control.
const STRIDE: u32 = 256;

/// One run's control; the thread that waits reads how far it is and may stop it.
#[derive(Debug)]
pub struct Control {
    signal: AtomicU8,
    done: AtomicU64,
    total: AtomicU64,
    /// Shortages of memory before the run.
    shortages: u64,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            signal: AtomicU8::new(GO_ON),
            done: AtomicU64::new(0),
            total: AtomicU64::new(0),
            shortages: shortages(),
        }
    }
}

impl Control {
    /// Give up: the work ends with [`KernelError::Interrupted`].
    pub fn abort(&self) {
        self.signal.store(ABORT, Relaxed);
    }

    /// Stop where it is and give out what there is; [`Control::abort`] goes first.
    pub fn enough(&self) {
        let _ = self.signal.compare_exchange(GO_ON, ENOUGH, Relaxed, Relaxed);
    }

    /// Units of work done and in all: whoever asks again never sees fewer, nor more done than there are.
    pub fn done(&self) -> (u64, u64) {
        let done = self.done.load(Relaxed);
        let total = self.total.load(Relaxed);
        (done.min(total), total)
    }
}

/// One thread's handle on the control.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    control: &'a Control,
    ticks: u32,
    scope: Scope,
}

/// What a handle's units are of the work that is told of.
#[derive(Clone, Copy, Debug)]
enum Scope {
    All,
    /// Units before these, and in all.
    Part(u64, u64),
    /// None of it.
    Nothing,
}

impl<'a> Progress<'a> {
    pub fn new(control: &'a Control) -> Self {
        Self { control, ticks: 0, scope: Scope::All }
    }

    /// A handle for a part of the work that comes after `before` of `total` units.
    pub fn part(&self, before: u64, total: u64) -> Self {
        Self { scope: Scope::Part(before, total), ..self.clone() }
    }

    /// A handle for work that is counted in other units than what is told of: it only looks whether to go on.
    pub fn silent(&self) -> Self {
        Self { scope: Scope::Nothing, ..self.clone() }
    }

    /// Now and then, say how far the work is and look whether to go on.
    ///
    /// # Errors
    /// As [`Progress::check`].
    #[inline]
    pub fn tick(&mut self, done: impl FnOnce() -> (u64, u64)) -> Result<(), KernelError> {
        self.ticks += 1;
        if self.ticks < STRIDE {
            return Ok(());
        }
        self.ticks = 0;
        let (done, total) = done();
        self.tell(done, total)
    }

    /// Now and then, look whether to go on.
    ///
    /// # Errors
    /// As [`Progress::check`].
    #[inline]
    pub fn check_now_and_then(&mut self) -> Result<(), KernelError> {
        self.ticks += 1;
        if self.ticks < STRIDE {
            return Ok(());
        }
        self.ticks = 0;
        self.check()
    }

    /// The same at once, between two phases of the work.
    ///
    /// # Errors
    /// As [`Progress::check`].
    pub fn tell(&mut self, done: u64, total: u64) -> Result<(), KernelError> {
        let (done, total) = match self.scope {
            Scope::All => (done, total),
            Scope::Part(before, all) => (before + done, all),
            Scope::Nothing => return self.check(),
        };
        // Threads tell in any order, and what is taken back is done once more: a bar goes on only.
        self.control.total.fetch_max(total, Relaxed);
        self.control.done.fetch_max(done.min(total), Relaxed);
        self.check()
    }

    /// Look whether to go on.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when the work is to be given up; [`KernelError::OutOfMemory`] when the system has no
    /// more memory, and the work goes on with what was reserved.
    pub fn check(&self) -> Result<(), KernelError> {
        if self.control.signal.load(Relaxed) == ABORT {
            return Err(KernelError::Interrupted);
        }
        if shortages() == self.control.shortages { Ok(()) } else { Err(KernelError::OutOfMemory) }
    }

    /// Whether the caller is content with what there is.
    #[inline]
    pub fn is_enough(&self) -> bool {
        self.control.signal.load(Relaxed) == ENOUGH
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_told_is_never_taken_back_nor_more_than_all() {
        let control = Control::default();
        let mut progress = Progress::new(&control);
        let told = [(3, 10), (2, 10), (12, 10), (1, 10)].map(|(done, total)| {
            progress.tell(done, total).unwrap();
            control.done()
        });
        assert_eq!(told, [(3, 10), (3, 10), (10, 10), (10, 10)]);
    }

    #[test]
    fn parts_are_counted_where_they_stand_and_silent_work_not_at_all() {
        let control = Control::default();
        let progress = Progress::new(&control);
        progress.part(5, 20).tell(3, 4).unwrap();
        progress.silent().tell(90, 100).unwrap();
        assert_eq!(control.done(), (8, 20));
        control.abort();
        assert_eq!(progress.silent().tell(1, 2), Err(KernelError::Interrupted));
    }
}
