//! The texels of a chart.

use super::texels::spans;

/// Which texels are taken, in rows.
#[derive(Debug)]
pub struct Bitmap {
    pub width: usize,
    pub height: usize,
    taken: Vec<bool>,
}

impl Bitmap {
    /// Room for triangles that begin at (0, 0), nothing taken.
    pub fn around(triangles: &[[[f64; 2]; 3]]) -> Self {
        let size = |k: usize| triangles.iter().flatten().map(|p| p[k]).fold(0.0, f64::max) as usize + 1;
        let (width, height) = (size(0), size(1));
        Self { width, height, taken: vec![false; width * height] }
    }

    /// Take the texels whose centres lie in a triangle, unless one is taken.
    pub fn claim(&mut self, corners: &[[f64; 2]; 3]) -> bool {
        let mut is_free = true;
        let each = |bitmap: &mut Self, work: &mut dyn FnMut(&mut [bool])| {
            for (row, columns) in spans(corners, bitmap.width, bitmap.height) {
                work(&mut bitmap.taken[row * bitmap.width..][columns]);
            }
        };
        each(self, &mut |texels| is_free &= !texels.contains(&true));
        if is_free {
            each(self, &mut |texels| texels.fill(true));
        }
        is_free
    }
}
