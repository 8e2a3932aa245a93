//! How far the work is, and whether to go on: what the threads at work share with the one that waits for them.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use crate::base::errors::KernelError;

const GO_ON: u8 = 0;
const ENOUGH: u8 = 1;
const ABORT: u8 = 2;

/// Ticks between two looks at the control.
const STRIDE: u32 = 256;

/// One run's control; the thread that waits reads how far it is and may stop it.
#[derive(Debug, Default)]
pub struct Control {
    signal: AtomicU8,
    done: AtomicU64,
    total: AtomicU64,
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

    /// Units of work done and in all.
    pub fn done(&self) -> (u64, u64) {
        (self.done.load(Relaxed), self.total.load(Relaxed))
    }
}

/// One thread's handle on the control.
#[derive(Clone, Debug)]
pub struct Progress<'a> {
    control: &'a Control,
    ticks: u32,
    /// Where this is a part of the work: units before it, and in all.
    within: Option<(u64, u64)>,
}

impl<'a> Progress<'a> {
    pub fn new(control: &'a Control) -> Self {
        Self { control, ticks: 0, within: None }
    }

    /// A handle for a part of the work that comes after `before` of `total` units.
    pub fn part(&self, before: u64, total: u64) -> Self {
        Self { within: Some((before, total)), ..self.clone() }
    }

    /// Now and then, say how far the work is and look whether to go on.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when the work is to be given up.
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
    /// [`KernelError::Interrupted`] when the work is to be given up.
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
    /// [`KernelError::Interrupted`] when the work is to be given up.
    pub fn tell(&mut self, done: u64, total: u64) -> Result<(), KernelError> {
        let (done, total) = self.within.map_or((done, total), |(before, all)| (before + done, all));
        self.control.done.store(done, Relaxed);
        self.control.total.store(total, Relaxed);
        self.check()
    }

    /// Look whether to go on.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when the work is to be given up.
    pub fn check(&self) -> Result<(), KernelError> {
        if self.control.signal.load(Relaxed) == ABORT { Err(KernelError::Interrupted) } else { Ok(()) }
    }

    /// Whether the caller is content with what there is.
    #[inline]
    pub fn is_enough(&self) -> bool {
        self.control.signal.load(Relaxed) == ENOUGH
    }
}
