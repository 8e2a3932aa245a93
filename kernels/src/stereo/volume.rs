//! A number for each pixel and disparity.

/// Disparities come in steps of so many, as many as the widest registers hold.
pub const LANES: usize = 16;

/// Levels of red, green and blue, a row of the image after another.
pub type Pixels = [[u8; 3]];

#[derive(Clone, Copy, Debug)]
pub struct Size {
    pub width: usize,
    pub height: usize,
}

impl Size {
    pub fn pixels(self) -> usize {
        self.width * self.height
    }
}

/// The disparities that are tried, `lowest` to `lowest + count − 1`.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    pub lowest: i32,
    /// A multiple of [`LANES`].
    pub count: usize,
}

/// Numbers of all disparities of a pixel, one pixel of a row after another.
pub type Volume = Vec<i16>;

/// A volume of zeros.
pub fn zeros(size: Size, search: Search) -> Volume {
    zeros_of(size.pixels() * search.count)
}

/// So many zeros, in large pages where the system has them: with small ones it takes as long to hand a volume out as to fill
/// it.
pub fn zeros_of(numbers: usize) -> Volume {
    let volume = vec![0; numbers];
    #[cfg(target_os = "linux")]
    {
        let start = (volume.as_ptr() as usize).next_multiple_of(PAGE);
        let end = volume.as_ptr_range().end as usize / PAGE * PAGE;
        if start < end {
            // SAFETY: these pages are the volume's alone, and keep what is in them; a system that refuses changes nothing.
            unsafe { libc::madvise(start as *mut libc::c_void, end - start, libc::MADV_HUGEPAGE) };
        }
    }
    volume
}

/// A large page of most systems, bytes.
#[cfg(target_os = "linux")]
const PAGE: usize = 2 << 20;
