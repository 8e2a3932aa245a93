//! Outline of a chart with its padding, rotated by quarter turns, as ranges of columns.

use super::texels::scanline_spans;

/// Number of quarter turns to try.
pub const QUARTER_TURNS: usize = 4;

/// Occupied columns as ranges, row by row.
#[derive(Debug)]
pub struct ChartOutline {
    pub width: usize,
    pub height: usize,
    /// Start index of each row's ranges, and the total at the end.
    starts: Vec<u32>,
    ranges: Vec<[u32; 2]>,
}

impl ChartOutline {
    /// Rasterise triangles whose box starts at (0, 0), and dilate them by `padding` texels on all sides.
    pub fn new(triangles: &[[[f64; 2]; 3]], size: [usize; 2], padding: usize) -> Self {
        let [width, height] = size.map(|s| s + 2 * padding);
        let mut taken = vec![false; width * height];
        for corners in triangles {
            // Mark the corners too, because a triangle may be thinner than a texel.
            for p in corners {
                let [x, y] = [0, 1].map(|k| (p[k] as usize).min(size[k] - 1));
                taken[y * width + x] = true;
            }
            for (row, columns) in scanline_spans(corners, size[0], size[1]) {
                taken[row * width..][columns].fill(true);
            }
        }
        // The triangles start at (0, 0). Extending them by 2 × padding to the right and downwards centres
        // them in the padded box.
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

    /// Return the occupied ranges of columns in a row.
    pub fn row_ranges(&self, row: usize) -> &[[u32; 2]] {
        &self.ranges[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// Rotate triangles in a box by quarter turns; returns the triangles and the size of the rotated box.
pub fn rotate_quarter_turns(
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
