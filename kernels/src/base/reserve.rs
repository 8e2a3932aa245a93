//! What happens when there is no more memory: the work ends with an error, and the process goes on.
//!
//! Rust aborts where an allocation fails, and nearly every line of a kernel allocates: tables, lists of a few entries, the
//! standard library, other crates. So none of them ever sees a failure. Before the work begins, a [`Reserve`] is taken
//! from the system in one piece, or the work does not begin. It is address space: as long as nobody writes to it, no memory
//! is behind it. [`Allocator`] gives out of it what the system refuses, and counts a shortage. [`Progress::check`], which
//! all long work asks anyway, finds that, and the work ends by the way of every other error. What is in use is freed
//! on this way, and then the reserve itself.
//!
//! A reserve must last from one check to the next. The sizes are where the work begins (`kernels/src/python/guarded.rs`),
//! and where it grows beyond its input ([`Reserve::new`] before each level of a normal mesh).
//!
//! [`Progress::check`]: super::progress::Progress::check

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::UnsafeCell;
use std::hint::spin_loop;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::*};

use super::errors::KernelError;

/// Reserves at a time: one of the module, one for each call that runs, one for each level that is made. Beyond that,
/// those that there are have to do.
const SLOTS: usize = 32;

/// The pieces of a reserve are multiples of this, or smaller powers of two; none is aligned to more.
const PAGE: usize = 4096;
/// No piece is smaller, so that a free one can name the next.
const SMALLEST: usize = 16;
/// Lists of free pieces: those of 16, 32, … 4096 bytes, and those of pages.
const LISTS: usize = (PAGE / SMALLEST).ilog2() as usize + 2;

static SHORTAGES: AtomicU64 = AtomicU64::new(0);
static TABLE: Table = Table {
    ranges: [const { Range { start: AtomicUsize::new(0), bytes: AtomicUsize::new(0) } }; SLOTS],
    used: AtomicUsize::new(0),
    is_locked: AtomicBool::new(false),
    blocks: UnsafeCell::new([const { Block::NONE }; SLOTS]),
};

/// Bytes to reserve for a row. With less and less memory, no kernel took more than 77 a row between two checks; in all they
/// take 150 to 250.
const ROW: usize = 192;
/// Bytes to reserve beside that, for tiny inputs and what each thread has. glibc keeps blocks of other sizes than before
/// once it has freed one of up to 32 MiB, so that this must be more.
const LEAST: usize = 64 << 20;

/// How often the system had no memory so far. All work that runs then is told, whoever asked for it.
#[inline]
pub fn shortages() -> u64 {
    SHORTAGES.load(Relaxed)
}

/// Whether the system has so many bytes now.
pub fn is_there(bytes: usize) -> bool {
    let Ok(layout) = Layout::from_size_align(bytes.max(1), PAGE) else { return false };
    // SAFETY: the layout is not empty, and nobody else knows the block.
    unsafe {
        let start = System.alloc(layout);
        if !start.is_null() {
            System.dealloc(start, layout);
        }
        !start.is_null()
    }
}

/// Memory set aside until this is dropped.
#[derive(Debug)]
pub struct Reserve {
    slot: Option<usize>,
    /// Rows it is enough for.
    rows: usize,
    shortages: u64,
}

impl Reserve {
    /// Set aside enough for work on so many rows: vertices and triangles of all meshes.
    ///
    /// # Errors
    /// As [`Reserve::new`].
    pub fn for_rows(rows: usize) -> Result<Self, KernelError> {
        let mut reserve = Self::new(LEAST.saturating_add(rows.saturating_mul(ROW)))?;
        reserve.rows = rows;
        Ok(reserve)
    }

    /// Set aside so many bytes.
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if the system has not as many.
    pub fn new(bytes: usize) -> Result<Self, KernelError> {
        let bytes = bytes.max(PAGE).next_multiple_of(PAGE);
        let layout = Layout::from_size_align(bytes, PAGE).map_err(|_| KernelError::OutOfMemory)?;
        // SAFETY: the layout is not empty.
        let start = unsafe { System.alloc(layout) };
        if start.is_null() {
            SHORTAGES.fetch_add(1, Relaxed);
            return Err(KernelError::OutOfMemory);
        }
        let slot = TABLE.with(|blocks| {
            let slot = blocks.iter().position(|block| block.start.is_null())?;
            blocks[slot] = Block { start, bytes, is_open: true, ..Block::NONE };
            TABLE.publish(slot, start, bytes);
            Some(slot)
        });
        if slot.is_none() {
            // SAFETY: nobody else knows it.
            unsafe { System.dealloc(start, layout) };
        }
        Ok(Self { slot, rows: 0, shortages: shortages() })
    }

    /// The same where work goes on to so many rows, and grows: set aside more than before if that is too little.
    ///
    /// # Errors
    /// As [`Reserve::new`], and as [`Reserve::check`].
    #[inline]
    pub fn cover(&mut self, rows: usize) -> Result<(), KernelError> {
        self.check()?;
        if rows > self.rows { self.grow(rows) } else { Ok(()) }
    }

    #[cold]
    fn grow(&mut self, rows: usize) -> Result<(), KernelError> {
        // Tables that grow double, and the old one stays until the new one is there.
        *self = Self::for_rows(2 * rows)?;
        Ok(())
    }

    /// Look whether there was enough memory since this was made.
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if there was not.
    pub fn check(&self) -> Result<(), KernelError> {
        if shortages() == self.shortages { Ok(()) } else { Err(KernelError::OutOfMemory) }
    }
}

impl Drop for Reserve {
    fn drop(&mut self) {
        let Some(slot) = self.slot else { return };
        let unused = TABLE.with(|blocks| {
            blocks[slot].is_open = false;
            TABLE.close(blocks, slot)
        });
        release(unused);
    }
}

/// The system's allocator, with the reserves behind it.
pub struct Allocator;

// SAFETY: a block comes from the system's allocator or from a reserve, and goes back where it came from; pieces of a
// reserve are apart from each other, large enough, and aligned (see `Block::take`). Nothing here panics.
unsafe impl GlobalAlloc for Allocator {
    #[inline]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as promised by the caller.
        let start = unsafe { System.alloc(layout) };
        if start.is_null() { spare(layout) } else { start }
    }

    #[inline]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as promised by the caller.
        let start = unsafe { System.alloc_zeroed(layout) };
        if !start.is_null() {
            return start;
        }
        let start = spare(layout);
        if !start.is_null() {
            // SAFETY: the piece has so many bytes.
            unsafe { start.write_bytes(0, layout.size()) };
        }
        start
    }

    #[inline]
    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        if TABLE.may_hold(start) {
            // SAFETY: as promised by the caller.
            unsafe { give(start, layout) };
        } else {
            // SAFETY: it is in no reserve, so it is the system's.
            unsafe { System.dealloc(start, layout) };
        }
    }

    #[inline]
    unsafe fn realloc(&self, start: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !TABLE.may_hold(start) {
            // SAFETY: it is in no reserve, so it is the system's.
            let moved = unsafe { System.realloc(start, layout, size) };
            if !moved.is_null() {
                return moved;
            }
        }
        // SAFETY: as promised by the caller; the old block is freed only after its contents are elsewhere.
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

/// A piece of any reserve, null if none has room. Either way it is a shortage.
#[cold]
fn spare(layout: Layout) -> *mut u8 {
    SHORTAGES.fetch_add(1, Relaxed);
    // The latest first: the oldest is that of the module, which is small.
    TABLE.with(|blocks| blocks.iter_mut().rev().find_map(|block| block.take(layout)).unwrap_or(null_mut()))
}

/// Free what may come from a reserve.
///
/// # Safety
/// As [`GlobalAlloc::dealloc`].
#[cold]
unsafe fn give(start: *mut u8, layout: Layout) {
    let unused = TABLE.with(|blocks| {
        let slot = blocks.iter().position(|block| block.holds(start))?;
        // SAFETY: it was taken from this block, whose pieces nobody else writes to under the lock.
        unsafe { blocks[slot].put_back(start, layout) };
        Some(TABLE.close(blocks, slot))
    });
    match unused {
        Some(unused) => release(unused),
        // SAFETY: it is in no reserve, so it is the system's.
        None => unsafe { System.dealloc(start, layout) },
    }
}

/// Give a block back to the system.
fn release(block: Option<Block>) {
    if let Some(block) = block {
        // SAFETY: it was allocated with this layout, and nothing of it is in use.
        unsafe { System.dealloc(block.start, Layout::from_size_align_unchecked(block.bytes, PAGE)) };
    }
}

/// Where a block lies, for those who free; apart from the block, which others write to.
struct Range {
    start: AtomicUsize,
    bytes: AtomicUsize,
}

/// All reserves.
struct Table {
    ranges: [Range; SLOTS],
    /// Slots that were ever in use.
    used: AtomicUsize,
    is_locked: AtomicBool,
    blocks: UnsafeCell<[Block; SLOTS]>,
}

// SAFETY: the blocks are reached under the lock only.
unsafe impl Sync for Table {}

impl Table {
    /// Work on the blocks, one thread at a time. A mutex of the standard library may allocate.
    fn with<R>(&self, work: impl FnOnce(&mut [Block; SLOTS]) -> R) -> R {
        while self.is_locked.compare_exchange_weak(false, true, Acquire, Relaxed).is_err() {
            spin_loop();
        }
        // SAFETY: this thread has the lock, and `work` cannot come back here: it allocates nothing.
        let result = work(unsafe { &mut *self.blocks.get() });
        self.is_locked.store(false, Release);
        result
    }

    /// Whether a block may be in a reserve: never wrong if it is in one.
    ///
    /// Who frees a piece has it from who took it, and a reserve stays where it is while one of its pieces is in use. So
    /// it is seen here without the lock. Other slots may be seen half changed; the lock then tells.
    #[inline]
    fn may_hold(&self, start: *const u8) -> bool {
        // As long as there was no shortage, nothing is: most processes look no further.
        shortages() > 0
            && self.ranges[..self.used.load(Relaxed).min(SLOTS)].iter().any(|range| {
                (start as usize).wrapping_sub(range.start.load(Relaxed)) < range.bytes.load(Relaxed)
            })
    }

    fn publish(&self, slot: usize, start: *mut u8, bytes: usize) {
        self.ranges[slot].start.store(start as usize, Relaxed);
        self.ranges[slot].bytes.store(bytes, Relaxed);
        self.used.fetch_max(slot + 1, Relaxed);
    }

    /// Take a block out of its slot if nobody needs it any more.
    fn close(&self, blocks: &mut [Block; SLOTS], slot: usize) -> Option<Block> {
        if blocks[slot].is_open || blocks[slot].live > 0 {
            return None;
        }
        self.publish(slot, null_mut(), 0);
        Some(std::mem::replace(&mut blocks[slot], Block::NONE))
    }
}

/// A free piece, in its own first bytes.
struct Free {
    next: *mut Free,
    bytes: usize,
}

/// One reserve: pieces in use and free ones, then what was never used.
struct Block {
    start: *mut u8,
    bytes: usize,
    /// Bytes before what was never used.
    begun: usize,
    /// Pieces in use.
    live: usize,
    /// Whether its [`Reserve`] is still there.
    is_open: bool,
    free: [*mut Free; LISTS],
}

impl Block {
    const NONE: Self =
        Self { start: null_mut(), bytes: 0, begun: 0, live: 0, is_open: false, free: [null_mut(); LISTS] };

    fn holds(&self, start: *const u8) -> bool {
        (start as usize).wrapping_sub(self.start as usize) < self.bytes
    }

    fn take(&mut self, layout: Layout) -> Option<*mut u8> {
        let (bytes, list) = piece(layout);
        if layout.align() > PAGE || bytes > self.bytes {
            return None;
        }
        let taken = self.take_free(bytes, list).or_else(|| {
            // Each piece is aligned to its size, or to a page if that is less.
            let at = self.begun.next_multiple_of(bytes.min(PAGE));
            if at > self.bytes - bytes {
                return None;
            }
            self.begun = at + bytes;
            // SAFETY: the piece lies within the block.
            Some(unsafe { self.start.add(at) })
        })?;
        self.live += 1;
        Some(taken)
    }

    /// The first free piece that is large enough, but no more than twice as large.
    fn take_free(&mut self, bytes: usize, list: usize) -> Option<*mut u8> {
        let mut link: *mut *mut Free = &mut self.free[list];
        // SAFETY: the links lead through free pieces of this block, which were written by `put_back`.
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

    /// # Safety
    /// `start` is a piece of this block in use, taken with this layout.
    unsafe fn put_back(&mut self, start: *mut u8, layout: Layout) {
        let (bytes, list) = piece(layout);
        self.live -= 1;
        if self.live == 0 {
            self.begun = 0;
            self.free = [null_mut(); LISTS];
            return;
        }
        let piece: *mut Free = start.cast();
        // SAFETY: no piece is smaller, or less aligned, than what is written.
        unsafe { piece.write(Free { next: self.free[list], bytes }) };
        self.free[list] = piece;
    }
}

/// Bytes of a piece for a layout, and the list it is in when free.
fn piece(layout: Layout) -> (usize, usize) {
    let least = layout.size().max(layout.align()).max(SMALLEST);
    if least > PAGE {
        // No layout is as large as to overflow here.
        return (least.next_multiple_of(PAGE), LISTS - 1);
    }
    let bytes = least.next_power_of_two();
    (bytes, (bytes / SMALLEST).ilog2() as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block over memory of its own, as a reserve has it.
    fn with_block(pages: usize, test: impl FnOnce(&mut Block)) {
        let layout = layout(pages * PAGE, PAGE);
        // SAFETY: the layout is not empty, and the block ends here.
        unsafe {
            let start = System.alloc(layout);
            test(&mut Block { start, bytes: layout.size(), is_open: true, ..Block::NONE });
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
                let Some(start) = block.take(layout) else { continue };
                assert_eq!(start as usize % layout.align(), 0);
                assert!(block.holds(start) && block.holds(start.wrapping_add(layout.size() - 1)));
                // SAFETY: the piece has so many bytes.
                unsafe { start.write_bytes(turn as u8, layout.size()) };
                pieces.push((start, layout, turn as u8));
            }
            assert!(pieces.len() > 10);
        });
    }

    #[test]
    fn a_full_block_refuses_and_an_empty_one_begins_anew() {
        with_block(4, |block| {
            let whole = layout(4 * PAGE, 8);
            let start = block.take(whole).unwrap();
            assert!(block.take(layout(1, 1)).is_none());
            // SAFETY: the piece is in use.
            unsafe { block.put_back(start, whole) };
            assert_eq!(block.take(whole), Some(start));
        });
    }

    #[test]
    fn what_is_freed_again_and_again_takes_no_more_than_once() {
        with_block(6, |block| {
            block.take(layout(PAGE, 8)).unwrap();
            for size in [24, 3 * PAGE, 3 * PAGE - 1, 100].repeat(100) {
                let start = block.take(layout(size, 8)).unwrap();
                // SAFETY: the piece is in use.
                unsafe { block.put_back(start, layout(size, 8)) };
            }
        });
    }

    #[test]
    fn more_than_there_is_and_stricter_alignments_are_refused() {
        with_block(4, |block| {
            assert!(block.take(layout(4 * PAGE + 1, 1)).is_none());
            assert!(block.take(layout(1, 2 * PAGE)).is_none());
            assert_eq!(block.live, 0);
        });
    }
}
