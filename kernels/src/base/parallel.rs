//! Multithreaded loops whose results do not depend on the thread count. If the system refuses a thread, fewer
//! are used.

use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{self, Scope, ScopedJoinHandle};

use super::memory_reserve;

/// Bytes that must be available before a thread is created: its stack, and the allocations of the C library
/// at thread start, which abort the process if they fail. Must exceed 32 MiB, because glibc raises its mmap
/// threshold up to that size once it has freed such a block.
const THREAD_BYTES: usize = 64 << 20;

/// Run `work` on a new thread; None if the system refuses one.
pub fn spawn_if_possible<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Option<ScopedJoinHandle<'scope, T>> {
    if !memory_reserve::is_allocatable(THREAD_BYTES) {
        return None;
    }
    thread::Builder::new().spawn_scoped(scope, work).ok()
}

/// Run `work` on up to `others` other threads and `own` on this one, and wait for all. A panic is resumed.
///
/// The closures have no type parameters: the code that starts threads would otherwise be compiled for each
/// of hundreds of loops.
fn run_beside(others: usize, work: &(dyn Fn() + Sync), own: &mut dyn FnMut()) {
    thread::scope(|scope| {
        let others: Vec<_> = (0..others).map_while(|_| spawn_if_possible(scope, work)).collect();
        own();
        for other in others {
            if let Err(panic) = other.join() {
                std::panic::resume_unwind(panic);
            }
        }
    });
}

/// Call `work` for every index below `count`, and return the results in index order. Each thread creates its
/// `scratch` once.
///
/// Indices are assigned to threads dynamically, so `work` must depend on its index only.
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
    let all = Mutex::new(Vec::with_capacity(count));
    let run = || {
        let mut scratch = scratch();
        let mut done: Vec<(usize, T)> = vec![];
        loop {
            let part = next.fetch_add(1, Relaxed);
            if part >= count {
                break;
            }
            done.push((part, work(&mut scratch, part)));
        }
        all.lock().unwrap_or_else(PoisonError::into_inner).append(&mut done);
    };
    run_beside(threads - 1, &run, &mut || run());
    // To sort would compile a sort for each type.
    let mut results: Vec<Option<T>> = (0..count).map(|_| None).collect();
    for (part, result) in all.into_inner().unwrap_or_else(PoisonError::into_inner) {
        results[part] = Some(result);
    }
    results.into_iter().flatten().collect()
}

/// Contiguous parts of a loop per thread. Threads take the next part when they have finished one, because
/// elements that are close together often take equally long: a frame sees only some of the vertices.
const PARTS_PER_THREAD: usize = 8;

/// Fill a slice with `value(index)`; each thread fills contiguous parts.
pub fn fill<T: Send>(values: &mut [T], threads: usize, value: impl Fn(usize) -> T + Sync) {
    update(values, threads, |i, slot| *slot = value(i));
}

/// Update each element of a slice with `change(index, element)`; each thread updates contiguous parts.
pub fn update<T: Send>(values: &mut [T], threads: usize, change: impl Fn(usize, &mut T) + Sync) {
    let parts = if threads > 1 { threads * PARTS_PER_THREAD } else { 1 };
    let part = values.len().div_ceil(parts).max(1);
    for_each_part(
        values.chunks_mut(part).enumerate().collect(),
        threads,
        |(number, values): (usize, &mut [T])| {
            for (i, slot) in values.iter_mut().enumerate() {
                change(number * part + i, slot);
            }
        },
    );
}

/// Collect `value(index)` for each index below `count`; each thread computes contiguous parts.
pub fn collect<T: Send>(count: usize, threads: usize, value: impl Fn(usize) -> T + Sync) -> Vec<T> {
    if threads <= 1 {
        return (0..count).map(value).collect();
    }
    let mut values = Vec::with_capacity(count);
    // The memory is first touched by the threads that fill it, because page faults cost more than the values.
    fill(&mut values.spare_capacity_mut()[..count], threads, |i| MaybeUninit::new(value(i)));
    // SAFETY: the capacity is at least `count`, and every element was written: all threads have ended, none
    // by a panic.
    unsafe { values.set_len(count) };
    values
}

/// Call `work` on each part and pass it by value; threads take the next part dynamically.
pub fn for_each_part<T: Send>(parts: Vec<T>, threads: usize, work: impl Fn(T) + Sync) {
    let threads = threads.min(parts.len());
    let parts = Mutex::new(parts.into_iter());
    let next = || parts.lock().ok().and_then(|mut parts| parts.next());
    let run = || {
        while let Some(part) = next() {
            work(part);
        }
    };
    run_beside(threads.saturating_sub(1), &run, &mut || run());
}

/// Run two closures concurrently if a second thread is available, otherwise one after the other.
pub fn run_concurrently(threads: usize, one: impl FnOnce() + Send, other: impl FnOnce()) {
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
    let mut other = Some(other);
    run_beside(1, &run, &mut || {
        if let Some(other) = other.take() {
            other();
        }
    });
    // No thread was available for `one`.
    run();
}

/// Return the thread count: `wanted` if above 0, else SCANLOOM_THREADS (set if several processes share a
/// machine), else one per core.
pub fn resolve_thread_count(wanted: usize) -> usize {
    static DEFAULT_COUNT: OnceLock<usize> = OnceLock::new();
    if wanted > 0 {
        wanted
    } else {
        *DEFAULT_COUNT.get_or_init(|| thread_count_from_environment().unwrap_or_else(core_count))
    }
}

fn thread_count_from_environment() -> Option<usize> {
    std::env::var("SCANLOOM_THREADS").ok()?.parse().ok().filter(|&count| count > 0)
}

fn core_count() -> usize {
    thread::available_parallelism().map_or(1, |n| n.get())
}
