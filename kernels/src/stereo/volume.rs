//! Cost volume: one value per pixel and disparity.

/// Disparity counts are multiples of this, the number of 16-bit values in a 256-bit register.
pub const LANES: usize = 16;

/// RGB image, row by row.
pub type Pixels = [[u8; 3]];

/// Image size in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    pub width: usize,
    pub height: usize,
}

impl Size {
    /// Return the number of pixels.
    pub fn pixels(self) -> usize {
        self.width * self.height
    }
}

/// Disparity search range, `lowest` to `lowest + count − 1`.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    pub lowest: i32,
    /// Number of disparities, a multiple of [`LANES`].
    pub count: usize,
}

/// Values of all disparities of a pixel, then the next pixel of the row.
pub type Volume = Vec<i16>;

/// Allocate a volume of zeros.
pub fn zeros(size: Size, search: Search) -> Volume {
    zeros_of(size.pixels() * search.count)
}

/// Allocate zeros in huge pages if the system supports them. With small pages, page faults take as long as
/// the computation of a volume.
pub fn zeros_of(numbers: usize) -> Volume {
    let volume = vec![0; numbers];
    #[cfg(target_os = "linux")]
    {
        let start = (volume.as_ptr() as usize).next_multiple_of(PAGE);
        let end = volume.as_ptr_range().end as usize / PAGE * PAGE;
        if start < end {
            // SAFETY: these pages belong to the volume alone and keep their contents; if the system refuses,
            // nothing changes.
            unsafe { libc::madvise(start as *mut libc::c_void, end - start, libc::MADV_HUGEPAGE) };
        }
    }
    volume
}

/// Size of a huge page on most systems, in bytes.
#[cfg(target_os = "linux")]
const PAGE: usize = 2 << 20;
