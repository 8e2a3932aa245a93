//! Cost volume: one value per pixel and disparity.

/// Disparity counts are multiples of this, the number of 16-bit values in a 256-bit register.
pub const LANES: usize = 16;

/// RGB image, row by row.
pub type RgbImage = [[u8; 3]];

/// Image size in pixels.
#[derive(Clone, Copy, Debug)]
pub struct ImageSize {
    pub width: usize,
    pub height: usize,
}

impl ImageSize {
    /// Return the number of pixels.
    pub fn pixel_count(self) -> usize {
        self.width * self.height
    }
}

/// Disparity search range, `lowest` to `lowest + count − 1`.
#[derive(Clone, Copy, Debug)]
pub struct DisparityRange {
    pub lowest: i32,
    /// Number of disparities, a multiple of [`LANES`].
    pub count: usize,
}

/// Values of all disparities of a pixel, then the next pixel of the row.
pub type CostVolume = Vec<i16>;

/// Allocate a volume of zeros.
pub fn allocate_volume(size: ImageSize, search: DisparityRange) -> CostVolume {
    allocate_zeros(size.pixel_count() * search.count)
}

/// Allocate zeros in huge pages if the system supports them. With small pages, page faults take as long as
/// the computation of a volume.
pub fn allocate_zeros(numbers: usize) -> CostVolume {
    let volume = vec![0; numbers];
    #[cfg(target_os = "linux")]
    {
        let start = (volume.as_ptr() as usize).next_multiple_of(HUGE_PAGE_BYTES);
        let end = volume.as_ptr_range().end as usize / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
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
const HUGE_PAGE_BYTES: usize = 2 << 20;
