//! The room that a chart takes in an image, with what is around it, turned as it may be put there.

use super::texels::spans;

/// Quarter turns that are tried.
pub const TURNS: usize = 4;

/// Columns that are taken, row by row.
#[derive(Debug)]
pub struct Shape {
    pub width: usize,
    pub height: usize,
    /// Where the ranges of each row begin, and after the last.
    starts: Vec<u32>,
    ranges: Vec<[u32; 2]>,
}

impl Shape {
    /// What triangles take with `padding` texels around them, to all sides; they begin at (0, 0).
    pub fn new(triangles: &[[[f64; 2]; 3]], size: [usize; 2], padding: usize) -> Self {
        let [width, height] = size.map(|s| s + 2 * padding);
        let mut taken = vec![false; width * height];
        for corners in triangles {
            // Corners too: a triangle may be thinner than a texel.
            for p in corners {
                let [x, y] = [0, 1].map(|k| (p[k] as usize).min(size[k] - 1));
                taken[y * width + x] = true;
            }
            for (row, columns) in spans(corners, size[0], size[1]) {
                taken[row * width..][columns].fill(true);
            }
        }
        // What is taken lies in the corner: wide ranges to the right, and rows downwards, bring it into the middle.
        let reach = 2 * padding + 1;
        let mut below = vec![0u32; width];
        let (mut starts, mut ranges) = (vec![0], Vec::<[u32; 2]>::new());
        for taken in taken.chunks_exact(width) {
            for (below, &is_taken) in below.iter_mut().zip(taken) {
                *below = if is_taken { reach as u32 } else { below.saturating_sub(1) };
            }
            let first = ranges.len();
            let mut column = 0;
            for run in below.chunk_by(|a, b| (*a > 0) == (*b > 0)) {
                let range = [column as u32, (column + run.len() - 1 + reach) as u32];
                column += run.len();
                if run[0] > 0 {
                    match ranges[first..].last_mut() {
                        Some(last) if range[0] <= last[1] => last[1] = range[1],
                        _ => ranges.push(range),
                    }
                }
            }
            starts.push(ranges.len() as u32);
        }
        Self { width, height, starts, ranges }
    }

    pub fn row(&self, row: usize) -> &[[u32; 2]] {
        &self.ranges[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// Triangles in a box after some quarter turns, and the box.
pub fn turned(
    triangles: &[[[f64; 2]; 3]],
    [width, height]: [usize; 2],
    turns: usize,
) -> (Vec<[[f64; 2]; 3]>, [usize; 2]) {
    let (w, h) = (width as f64, height as f64);
    let turn = |[x, y]: [f64; 2]| match turns {
        0 => [x, y],
        1 => [h - y, x],
        2 => [w - x, h - y],
        _ => [y, w - x],
    };
    let size = if turns.is_multiple_of(2) { [width, height] } else { [height, width] };
    (triangles.iter().map(|corners| corners.map(turn)).collect(), size)
}
