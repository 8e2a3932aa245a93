//! The same work on many parts, on several threads, with results that do not depend on how many. Where the system has no
//! room for a thread, there are fewer.

use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, OnceLock};
use std::thread::{self, Scope, ScopedJoinHandle};

use super::reserve;

/// What must be there before a thread is made: its stack, and what the C library takes at a thread's first steps, where it
/// ends the process if it cannot have it. glibc keeps blocks of other sizes than before once it has freed one of up to
/// 32 MiB, so that this must be more.
const THREAD: usize = 64 << 20;

/// `work` on a thread of its own, none if the system refuses one.
pub fn spawn<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Option<ScopedJoinHandle<'scope, T>> {
    if !reserve::is_there(THREAD) {
        return None;
    }
    thread::Builder::new().spawn_scoped(scope, work).ok()
}

/// `work` on every number below `count`; the results in this order. Each thread makes its `scratch` once.
///
/// Which thread takes which part is left to chance, so `work` must depend on nothing but its number.
pub fn map<T: Send, S>(
    count: usize,
    threads: usize,
    scratch: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, usize) -> T + Sync,
) -> Vec<T> {
    let threads = threads.min(count);
    if threads <= 1 {
        let mut scratch = scratch();
        return (0..count).map(|part| work(&mut scratch, part)).collect();
    }
    let next = AtomicUsize::new(0);
    let run = || {
        let mut scratch = scratch();
        let mut done = vec![];
        loop {
            let part = next.fetch_add(1, Relaxed);
            if part >= count {
                return done;
            }
            done.push((part, work(&mut scratch, part)));
        }
    };
    let mut results: Vec<(usize, T)> = thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map_while(|_| spawn(scope, run)).collect();
        let mut all = run();
        for other in others {
            match other.join() {
                Ok(done) => all.extend(done),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        all
    });
    results.sort_unstable_by_key(|r| r.0);
    results.into_iter().map(|r| r.1).collect()
}

/// Fill a slice with a value for each place, each thread a part of it.
pub fn fill<T: Send>(values: &mut [T], threads: usize, value: impl Fn(usize) -> T + Sync) {
    update(values, threads, |i, slot| *slot = value(i));
}

/// Change each place of a slice, each thread a part of them.
pub fn update<T: Send>(values: &mut [T], threads: usize, change: impl Fn(usize, &mut T) + Sync) {
    let part = values.len().div_ceil(threads.max(1)).max(1);
    each(values.chunks_mut(part).enumerate().collect(), threads, |(number, values): (usize, &mut [T])| {
        for (i, slot) in values.iter_mut().enumerate() {
            change(number * part + i, slot);
        }
    });
}

/// A value for each number below `count`, each thread a part of them.
pub fn collect<T: Send>(count: usize, threads: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    if threads <= 1 {
        return (0..count).map(value).collect();
    }
    let mut values = Vec::with_capacity(count);
    // Memory is touched first where it is filled: that costs more than filling it.
    fill(&mut values.spare_capacity_mut()[..count], threads, |i| MaybeUninit::new(value(i)));
    // SAFETY: there is room for `count` values, and each place has got one: the threads that fill have ended, none by a panic.
    unsafe { values.set_len(count) };
    values
}

/// `work` on each of some parts, which it takes with it.
pub fn each<T: Send>(parts: Vec<T>, threads: usize, work: impl Fn(T) + Sync) {
    let threads = threads.min(parts.len());
    let parts = Mutex::new(parts.into_iter());
    let next = || parts.lock().ok().and_then(|mut parts| parts.next());
    let run = || {
        while let Some(part) = next() {
            work(part);
        }
    };
    thread::scope(|scope| {
        let _others: Vec<_> = (1..threads).map_while(|_| spawn(scope, run)).collect();
        run();
    });
}

/// Two pieces of work side by side, if there is a thread to spare.
pub fn both(threads: usize, one: impl FnOnce() + Send, other: impl FnOnce()) {
    if threads <= 1 {
        one();
        other();
        return;
    }
    let one = Mutex::new(Some(one));
    let run = || {
        if let Some(one) = one.lock().ok().and_then(|mut one| one.take()) {
            one();
        }
    };
    thread::scope(|scope| {
        let _other = spawn(scope, run);
        other();
    });
    // If there was no thread for it.
    run();
}

/// The number of threads to use when `wanted` is 0: what the environment says, where several processes share a machine,
/// else one for each core.
pub fn threads(wanted: usize) -> usize {
    static USUAL: OnceLock<usize> = OnceLock::new();
    if wanted > 0 { wanted } else { *USUAL.get_or_init(|| said().unwrap_or_else(cores)) }
}

fn said() -> Option<usize> {
    std::env::var("SCANLOOM_THREADS").ok()?.parse().ok().filter(|&count| count > 0)
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, |n| n.get())
}
