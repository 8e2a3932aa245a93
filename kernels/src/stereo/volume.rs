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
    vec![0; size.pixels() * search.count]
}

/// The rows of a volume, with their numbers.
pub fn rows(volume: &mut [i16], size: Size, search: Search) -> Vec<(usize, &mut [i16])> {
    volume.chunks_mut(size.width * search.count).enumerate().collect()
}
