//! Reserved memory: if the system runs out of memory, the run ends with an error and the process survives.
//!
//! Rust aborts if an allocation fails, and nearly every line of a kernel allocates, including the standard
//! library and other crates. The allocator here prevents such failures. Before the work begins, a [`Reserve`]
//! is taken from the system in one block; if the system refuses, the work does not begin. The reserve is only
//! address space: no memory backs it until it is written. If the system refuses an allocation later,
//! [`Allocator`] serves it from the reserve and counts a shortage. [`Progress::check`], which all long loops
//! call anyway, detects the shortage and returns an error. Unwinding then frees the memory in use, and
//! finally the reserve.
//!
//! A reserve must last from one check to the next. Reserve sizes are set where the work begins
//! (`kernels/src/python/memory_guard.rs`), and where data grows beyond the input ([`Reserve::new`] before each
//! level of a normal mesh).
//!
//! [`Progress::check`]: super::progress::Progress::check

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::UnsafeCell;
use std::hint::spin_loop;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::*};

use super::errors::KernelError;

/// Maximum number of reserves: one for the module, one per running call, one per level under construction. If
/// all slots are taken, the existing reserves must suffice.
const MAX_RESERVES: usize = 32;

/// Pieces of a reserve are multiples of this, or smaller powers of two. It is also the maximum alignment.
const PAGE_BYTES: usize = 4096;
/// Minimum piece size in bytes, so that a free piece can hold its list entry.
const MIN_PIECE_BYTES: usize = 16;
/// Number of free lists: one per size of 16, 32, … 4096 bytes, and one for multiples of pages.
const FREE_LIST_COUNT: usize = (PAGE_BYTES / MIN_PIECE_BYTES).ilog2() as usize + 2;

static SHORTAGES: AtomicU64 = AtomicU64::new(0);
static TABLE: ReserveTable = ReserveTable {
    ranges: [const { BlockRange { start: AtomicUsize::new(0), bytes: AtomicUsize::new(0) } }; MAX_RESERVES],
    used: AtomicUsize::new(0),
    is_locked: AtomicBool::new(false),
    blocks: UnsafeCell::new([const { ReserveBlock::NONE }; MAX_RESERVES]),
};

/// Bytes to reserve per row. Measured with decreasing memory: at most 77 bytes a row between two checks.
/// Kernels use 150 to 250 bytes a row in total.
const BYTES_PER_ROW: usize = 192;
/// Bytes to reserve in addition, for tiny inputs and per-thread data. Must exceed 32 MiB, because glibc
/// raises its mmap threshold up to that size once it has freed such a block.
const BASE_BYTES: usize = 64 << 20;

/// Return the number of failed system allocations so far. Every run that is active at a shortage sees it,
/// whichever run allocated.
#[inline]
pub fn shortage_count() -> u64 {
    SHORTAGES.load(Relaxed)
}

/// Check that the system can currently allocate this number of bytes.
pub fn is_allocatable(bytes: usize) -> bool {
    let Ok(layout) = Layout::from_size_align(bytes.max(1), PAGE_BYTES) else { return false };
    // SAFETY: the layout is not empty, and no other code knows the block.
    unsafe {
        let start = System.alloc(layout);
        if !start.is_null() {
            System.dealloc(start, layout);
        }
        !start.is_null()
    }
}

/// Memory reserved until this value is dropped.
#[derive(Debug)]
pub struct Reserve {
    slot: Option<usize>,
    /// Number of rows that the reserve suffices for.
    rows: usize,
    shortages: u64,
}

impl Reserve {
    /// Reserve enough for work on a number of rows (vertices and triangles of all meshes).
    pub fn for_rows(rows: usize) -> Result<Self, KernelError> {
        let mut reserve = Self::new(BASE_BYTES.saturating_add(rows.saturating_mul(BYTES_PER_ROW)))?;
        reserve.rows = rows;
        Ok(reserve)
    }

    /// Reserve a number of bytes.
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if the system refuses the allocation.
    pub fn new(bytes: usize) -> Result<Self, KernelError> {
        let bytes = bytes.max(PAGE_BYTES).next_multiple_of(PAGE_BYTES);
        let layout = Layout::from_size_align(bytes, PAGE_BYTES).map_err(|_| KernelError::OutOfMemory)?;
        // SAFETY: the layout is not empty.
        let start = unsafe { System.alloc(layout) };
        if start.is_null() {
            SHORTAGES.fetch_add(1, Relaxed);
            return Err(KernelError::OutOfMemory);
        }
        let slot = TABLE.with_lock(|blocks| {
            let slot = blocks.iter().position(|block| block.start.is_null())?;
            blocks[slot] = ReserveBlock { start, bytes, is_open: true, ..ReserveBlock::NONE };
            TABLE.publish_range(slot, start, bytes);
            Some(slot)
        });
        if slot.is_none() {
            // SAFETY: no other code knows the block.
            unsafe { System.dealloc(start, layout) };
        }
        Ok(Self { slot, rows: 0, shortages: shortage_count() })
    }

    /// Make sure that the reserve suffices for a number of rows, for work that grows; enlarge it if it does
    /// not.
    #[inline]
    pub fn ensure_rows(&mut self, rows: usize) -> Result<(), KernelError> {
        self.check()?;
        if rows > self.rows { self.grow(rows) } else { Ok(()) }
    }

    #[cold]
    fn grow(&mut self, rows: usize) -> Result<(), KernelError> {
        // Twice the rows, because a growing table doubles and its old copy lives until the new one is filled.
        *self = Self::for_rows(2 * rows)?;
        Ok(())
    }

    /// Check that there was no memory shortage since the reserve was created.
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if there was one.
    pub fn check(&self) -> Result<(), KernelError> {
        if shortage_count() == self.shortages { Ok(()) } else { Err(KernelError::OutOfMemory) }
    }
}

impl Drop for Reserve {
    fn drop(&mut self) {
        let Some(slot) = self.slot else { return };
        let unused = TABLE.with_lock(|blocks| {
            blocks[slot].is_open = false;
            TABLE.take_unused(blocks, slot)
        });
        release_block(unused);
    }
}

/// The system allocator, with fallback to the reserves.
pub struct Allocator;

// SAFETY: a block comes from the system allocator or from a reserve, and is returned to its source. Pieces of
// a reserve are disjoint, large enough, and aligned (see `ReserveBlock::allocate`). Nothing here panics.
unsafe impl GlobalAlloc for Allocator {
    #[inline]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as promised by the caller.
        let start = unsafe { System.alloc(layout) };
        if start.is_null() { allocate_from_reserve(layout) } else { start }
    }

    #[inline]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as promised by the caller.
        let start = unsafe { System.alloc_zeroed(layout) };
        if !start.is_null() {
            return start;
        }
        let start = allocate_from_reserve(layout);
        if !start.is_null() {
            // SAFETY: the piece has at least this number of bytes.
            unsafe { start.write_bytes(0, layout.size()) };
        }
        start
    }

    #[inline]
    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        if TABLE.may_contain(start) {
            // SAFETY: as promised by the caller.
            unsafe { free_piece(start, layout) };
        } else {
            // SAFETY: the pointer is in no reserve, so it belongs to the system allocator.
            unsafe { System.dealloc(start, layout) };
        }
    }

    #[inline]
    unsafe fn realloc(&self, start: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !TABLE.may_contain(start) {
            // SAFETY: the pointer is in no reserve, so it belongs to the system allocator.
            let moved = unsafe { System.realloc(start, layout, size) };
            if !moved.is_null() {
                return moved;
            }
        }
        // SAFETY: as promised by the caller; the old block is freed only after its contents were copied.
        unsafe {
            let moved = self.alloc(Layout::from_size_align_unchecked(size, layout.align()));
            if !moved.is_null() {
                moved.copy_from_nonoverlapping(start, layout.size().min(size));
                self.dealloc(start, layout);
            }
            moved
        }
    }
}

/// Allocate from any reserve; null if none has space. Counts a shortage in both cases.
#[cold]
fn allocate_from_reserve(layout: Layout) -> *mut u8 {
    SHORTAGES.fetch_add(1, Relaxed);
    // Newest reserve first: the oldest one belongs to the module and is small.
    TABLE.with_lock(|blocks| {
        blocks.iter_mut().rev().find_map(|block| block.allocate(layout)).unwrap_or(null_mut())
    })
}

/// Free a block that may come from a reserve.
#[cold]
unsafe fn free_piece(start: *mut u8, layout: Layout) {
    let unused = TABLE.with_lock(|blocks| {
        let slot = blocks.iter().position(|block| block.contains(start))?;
        // SAFETY: the piece was taken from this block, and the lock excludes other writers.
        unsafe { blocks[slot].put_back(start, layout) };
        Some(TABLE.take_unused(blocks, slot))
    });
    match unused {
        Some(unused) => release_block(unused),
        // SAFETY: the pointer is in no reserve, so it belongs to the system allocator.
        None => unsafe { System.dealloc(start, layout) },
    }
}

/// Return a block to the system.
fn release_block(block: Option<ReserveBlock>) {
    if let Some(block) = block {
        // SAFETY: the block was allocated with this layout, and no piece of it is in use.
        unsafe { System.dealloc(block.start, Layout::from_size_align_unchecked(block.bytes, PAGE_BYTES)) };
    }
}

/// Address range of a block, for lock-free reads in `dealloc`; separate from the block, which is written
/// under the lock.
struct BlockRange {
    start: AtomicUsize,
    bytes: AtomicUsize,
}

/// Table of all reserves.
struct ReserveTable {
    ranges: [BlockRange; MAX_RESERVES],
    /// Upper bound of the slots used so far.
    used: AtomicUsize,
    is_locked: AtomicBool,
    blocks: UnsafeCell<[ReserveBlock; MAX_RESERVES]>,
}

// SAFETY: the blocks are accessed under the lock only.
unsafe impl Sync for ReserveTable {}

impl ReserveTable {
    /// Run `work` on the blocks under a spin lock. A mutex of the standard library may allocate.
    fn with_lock<R>(&self, work: impl FnOnce(&mut [ReserveBlock; MAX_RESERVES]) -> R) -> R {
        while self.is_locked.compare_exchange_weak(false, true, Acquire, Relaxed).is_err() {
            spin_loop();
        }
        // SAFETY: this thread holds the lock, and `work` cannot re-enter, because it allocates nothing.
        let result = work(unsafe { &mut *self.blocks.get() });
        self.is_locked.store(false, Release);
        result
    }

    /// Return true if a pointer may be in a reserve. False positives are possible, false negatives are not.
    ///
    /// A freeing thread received the piece from the allocating thread, and a reserve keeps its address while
    /// a piece is in use. So the range of that reserve is visible here without the lock. Other slots may be
    /// read half-updated; the lookup under the lock then decides.
    #[inline]
    fn may_contain(&self, start: *const u8) -> bool {
        // Without a shortage, no block is in a reserve. Most processes end the test here.
        shortage_count() > 0
            && self.ranges[..self.used.load(Relaxed).min(MAX_RESERVES)].iter().any(|range| {
                (start as usize).wrapping_sub(range.start.load(Relaxed)) < range.bytes.load(Relaxed)
            })
    }

    fn publish_range(&self, slot: usize, start: *mut u8, bytes: usize) {
        self.ranges[slot].start.store(start as usize, Relaxed);
        self.ranges[slot].bytes.store(bytes, Relaxed);
        self.used.fetch_max(slot + 1, Relaxed);
    }

    /// Remove a block from its slot if its reserve was dropped and no piece is in use.
    fn take_unused(&self, blocks: &mut [ReserveBlock; MAX_RESERVES], slot: usize) -> Option<ReserveBlock> {
        if blocks[slot].is_open || blocks[slot].used_pieces > 0 {
            return None;
        }
        self.publish_range(slot, null_mut(), 0);
        Some(std::mem::replace(&mut blocks[slot], ReserveBlock::NONE))
    }
}

/// List entry of a free piece, stored in the first bytes of the piece.
struct FreePiece {
    next: *mut FreePiece,
    bytes: usize,
}

/// One reserve: used and free pieces, followed by a part that was never used.
struct ReserveBlock {
    start: *mut u8,
    bytes: usize,
    /// Bytes before the part that was never used.
    used_bytes: usize,
    /// Number of pieces in use.
    used_pieces: usize,
    /// True while its [`Reserve`] exists.
    is_open: bool,
    free: [*mut FreePiece; FREE_LIST_COUNT],
}

impl ReserveBlock {
    const NONE: Self = Self {
        start: null_mut(),
        bytes: 0,
        used_bytes: 0,
        used_pieces: 0,
        is_open: false,
        free: [null_mut(); FREE_LIST_COUNT],
    };

    fn contains(&self, start: *const u8) -> bool {
        (start as usize).wrapping_sub(self.start as usize) < self.bytes
    }

    fn allocate(&mut self, layout: Layout) -> Option<*mut u8> {
        let (bytes, list) = piece_size(layout);
        if layout.align() > PAGE_BYTES || bytes > self.bytes {
            return None;
        }
        let taken = self.take_free(bytes, list).or_else(|| {
            // Each piece is aligned to its size, or to a page if the size is larger.
            let at = self.used_bytes.next_multiple_of(bytes.min(PAGE_BYTES));
            if at > self.bytes - bytes {
                return None;
            }
            self.used_bytes = at + bytes;
            // SAFETY: the piece is inside the block.
            Some(unsafe { self.start.add(at) })
        })?;
        self.used_pieces += 1;
        Some(taken)
    }

    /// Take the first free piece that is large enough, but at most twice as large.
    fn take_free(&mut self, bytes: usize, list: usize) -> Option<*mut u8> {
        let mut link: *mut *mut FreePiece = &mut self.free[list];
        // SAFETY: all links point to free pieces of this block, which `restore_vertex` wrote.
        unsafe {
            while !(*link).is_null() {
                let found = *link;
                if (*found).bytes >= bytes && (*found).bytes / 2 <= bytes {
                    *link = (*found).next;
                    return Some(found.cast());
                }
                link = &raw mut (*found).next;
            }
        }
        None
    }

    /// Put a piece on its free list.
    ///
    /// # Safety
    /// `start` must be a used piece of this block, taken with the same layout.
    unsafe fn put_back(&mut self, start: *mut u8, layout: Layout) {
        let (bytes, list) = piece_size(layout);
        self.used_pieces -= 1;
        if self.used_pieces == 0 {
            self.used_bytes = 0;
            self.free = [null_mut(); FREE_LIST_COUNT];
            return;
        }
        let piece: *mut FreePiece = start.cast();
        // SAFETY: every piece is at least as large and as aligned as a list entry.
        unsafe { piece.write(FreePiece { next: self.free[list], bytes }) };
        self.free[list] = piece;
    }
}

/// Compute the piece size in bytes for a layout, and the index of its free list.
fn piece_size(layout: Layout) -> (usize, usize) {
    let least = layout.size().max(layout.align()).max(MIN_PIECE_BYTES);
    if least > PAGE_BYTES {
        // A valid layout is too small to overflow here.
        return (least.next_multiple_of(PAGE_BYTES), FREE_LIST_COUNT - 1);
    }
    let bytes = least.next_power_of_two();
    (bytes, (bytes / MIN_PIECE_BYTES).ilog2() as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Run a test on a block with separate memory, set up like a reserve.
    fn with_block(pages: usize, test: impl FnOnce(&mut ReserveBlock)) {
        let layout = layout(pages * PAGE_BYTES, PAGE_BYTES);
        // SAFETY: the layout is not empty, and the block is not used after this scope.
        unsafe {
            let start = System.alloc(layout);
            test(&mut ReserveBlock { start, bytes: layout.size(), is_open: true, ..ReserveBlock::NONE });
            System.dealloc(start, layout);
        }
    }

    fn layout(size: usize, align: usize) -> Layout {
        Layout::from_size_align(size, align).unwrap()
    }

    #[test]
    fn pieces_are_aligned_and_apart_whatever_was_freed_before() {
        with_block(64, |block| {
            let mut pieces: Vec<(*mut u8, Layout, u8)> = vec![];
            for turn in 0..2000usize {
                if turn % 3 == 2 && !pieces.is_empty() {
                    let (start, layout, mark) = pieces.swap_remove(turn * 7 % pieces.len());
                    // SAFETY: the piece is in use.
                    unsafe {
                        assert!(std::slice::from_raw_parts(start, layout.size()).iter().all(|&b| b == mark));
                        block.put_back(start, layout);
                    }
                }
                let layout = layout(1 + turn * turn * 31 % 6000, 1 << (turn % 13));
                let Some(start) = block.allocate(layout) else { continue };
                assert_eq!(start as usize % layout.align(), 0);
                assert!(block.contains(start) && block.contains(start.wrapping_add(layout.size() - 1)));
                // SAFETY: the piece has at least this number of bytes.
                unsafe { start.write_bytes(turn as u8, layout.size()) };
                pieces.push((start, layout, turn as u8));
            }
            assert!(pieces.len() > 10);
        });
    }

    #[test]
    fn a_full_block_refuses_and_an_empty_one_begins_anew() {
        with_block(4, |block| {
            let whole = layout(4 * PAGE_BYTES, 8);
            let start = block.allocate(whole).unwrap();
            assert!(block.allocate(layout(1, 1)).is_none());
            // SAFETY: the piece is in use.
            unsafe { block.put_back(start, whole) };
            assert_eq!(block.allocate(whole), Some(start));
        });
    }

    #[test]
    fn what_is_freed_again_and_again_takes_no_more_than_once() {
        with_block(6, |block| {
            block.allocate(layout(PAGE_BYTES, 8)).unwrap();
            for size in [24, 3 * PAGE_BYTES, 3 * PAGE_BYTES - 1, 100].repeat(100) {
                let start = block.allocate(layout(size, 8)).unwrap();
                // SAFETY: the piece is in use.
                unsafe { block.put_back(start, layout(size, 8)) };
            }
        });
    }

    #[test]
    fn more_than_there_is_and_stricter_alignments_are_refused() {
        with_block(4, |block| {
            assert!(block.allocate(layout(4 * PAGE_BYTES + 1, 1)).is_none());
            assert!(block.allocate(layout(1, 2 * PAGE_BYTES)).is_none());
            assert_eq!(block.used_pieces, 0);
        });
    }
}
