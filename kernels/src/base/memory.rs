//! Return of free memory from the allocator to the system.

/// Return free pages to the system.
///
/// Long-lived results of a region are allocated between its temporary tables. glibc keeps the freed space in
/// fragments too small for the next large table. Other allocators return pages without this call.
pub fn release_free_memory() {
    // SAFETY: the call takes no pointer, and is allowed at any time from any thread.
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    unsafe {
        libc::malloc_trim(0);
    }
}
