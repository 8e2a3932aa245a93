//! Work on numbered chunks, shared between threads; the results come back in the order of the chunks.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};

use crate::error::KernelError;
use crate::progress::Progress;

/// How often the caller hears of the work, and the other threads whether to go on.
const PERIOD: Duration = Duration::from_millis(50);

/// Asked now and then in long work; false means stop.
pub type GoOn<'a> = &'a mut dyn FnMut() -> bool;

/// All processors for 0 threads asked for.
pub fn thread_count(threads: usize) -> usize {
    if threads > 0 { threads } else { std::thread::available_parallelism().map_or(1, |n| n.get()) }
}

/// `work(chunk, state, go_on)` for every chunk. Each thread has a `state` of its own, which must not change what a
/// chunk's result is; all states come back beside the results.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn for_chunks<S: Send, R: Send>(
    chunks: usize,
    threads: usize,
    state: impl Fn() -> S + Sync,
    work: impl Fn(usize, &mut S, GoOn<'_>) -> R + Sync,
    progress: &mut Progress,
    (done, each, total): (u64, u64, u64),
) -> Result<(Vec<R>, Vec<S>), KernelError> {
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let run = |go_on: GoOn<'_>| {
        let (mut state, mut results) = (state(), vec![]);
        while go_on() {
            let chunk = next.fetch_add(1, Relaxed);
            if chunk >= chunks {
                break;
            }
            results.push((chunk, work(chunk, &mut state, go_on)));
        }
        (results, state)
    };
    let mut last = Instant::now();
    let mut told = || {
        if last.elapsed() >= PERIOD {
            last = Instant::now();
            let so_far = done + each * next.load(Relaxed).min(chunks) as u64;
            if progress.tell(so_far.min(total), total).is_err() {
                stop.store(true, Relaxed);
            }
        }
        !stop.load(Relaxed)
    };
    let parts = std::thread::scope(|scope| {
        let helpers: Vec<_> =
            (1..threads.min(chunks)).map(|_| scope.spawn(|| run(&mut || !stop.load(Relaxed)))).collect();
        let mine = run(&mut told);
        let mut parts = vec![mine];
        for helper in helpers {
            // The caller can still stop the work while the others finish theirs.
            while !helper.is_finished() && told() {
                std::thread::sleep(Duration::from_micros(200));
            }
            match helper.join() {
                Ok(part) => parts.push(part),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        parts
    });
    if stop.load(Relaxed) {
        return Err(KernelError::Interrupted);
    }
    let (mut results, mut states) = (Vec::with_capacity(chunks), vec![]);
    for (part, state) in parts {
        results.extend(part);
        states.push(state);
    }
    results.sort_unstable_by_key(|&(chunk, _)| chunk);
    Ok((results.into_iter().map(|(_, result)| result).collect(), states))
}
