//! Memory that is free, but still held by the allocator.

/// Give free pages back to the system.
///
/// What regions leave lies between what they needed for a while. glibc's allocator keeps all of it, in pieces too small
/// for the next large table; others give pages back by themselves.
pub fn give_back() {
    // SAFETY: it takes no pointer, and may be called at any time from any thread.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        libc::malloc_trim(0);
    }
}
