//! Occupied texels of a chart.

use super::texels::scanline_spans;

/// Texels by which a bitmap grows beyond the required size on each side.
const GROWTH_MARGIN: i64 = 16;

/// Occupied texels in row-major order; grows on demand, also to the left and upwards.
#[derive(Debug)]
pub struct ChartBitmap {
    /// Coordinates of the first texel.
    origin: [i64; 2],
    width: usize,
    height: usize,
    occupied: Vec<bool>,
}

impl ChartBitmap {
    /// Create an empty bitmap large enough for triangles whose box starts at (0, 0).
    pub fn covering(triangles: &[[[f64; 2]; 3]]) -> Self {
        let size = |k: usize| triangles.iter().flatten().map(|p| p[k]).fold(0.0, f64::max) as usize + 1;
        let (width, height) = (size(0), size(1));
        Self { origin: [0, 0], width, height, occupied: vec![false; width * height] }
    }

    /// Mark the texels whose centres are inside a triangle; return false and mark nothing if one is occupied.
    pub fn claim(&mut self, corners: &[[f64; 2]; 3]) -> bool {
        self.grow_to(corners);
        let mut is_free = true;
        self.for_each_row(corners, |texels| is_free &= !texels.contains(&true));
        if is_free {
            self.for_each_row(corners, |texels| texels.fill(true));
        }
        is_free
    }

    /// Clear the texels that a triangle has claimed.
    pub fn release(&mut self, corners: &[[f64; 2]; 3]) {
        self.for_each_row(corners, |texels| texels.fill(false));
    }

    fn for_each_row(&mut self, corners: &[[f64; 2]; 3], mut work: impl FnMut(&mut [bool])) {
        let [x, y] = self.origin.map(|place| place as f64);
        for (row, columns) in scanline_spans(&corners.map(|p| [p[0] - x, p[1] - y]), self.width, self.height)
        {
            work(&mut self.occupied[row * self.width..][columns]);
        }
    }

    /// Grow the bitmap so that it contains a triangle.
    fn grow_to(&mut self, corners: &[[f64; 2]; 3]) {
        let end = [self.origin[0] + self.width as i64, self.origin[1] + self.height as i64];
        let mut room = [self.origin, end];
        for k in 0..2 {
            let low = corners.iter().map(|p| p[k].floor() as i64).min().unwrap_or(0);
            let high = corners.iter().map(|p| p[k].floor() as i64 + 1).max().unwrap_or(0);
            if low < room[0][k] {
                room[0][k] = low - GROWTH_MARGIN;
            }
            if high > room[1][k] {
                room[1][k] = high + GROWTH_MARGIN + (high - room[0][k]) / 4;
            }
        }
        if room == [self.origin, end] {
            return;
        }
        let size = [0, 1].map(|k| (room[1][k] - room[0][k]) as usize);
        let mut taken = vec![false; size[0] * size[1]];
        let shift = [0, 1].map(|k| (self.origin[k] - room[0][k]) as usize);
        for row in 0..self.height {
            let before = &self.occupied[row * self.width..][..self.width];
            taken[(row + shift[1]) * size[0] + shift[0]..][..self.width].copy_from_slice(before);
        }
        *self = Self { origin: room[0], width: size[0], height: size[1], occupied: taken };
    }
}
