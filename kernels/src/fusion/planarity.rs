//! Planarity of the surface in a depth map.
//!
//! A voxel in front of the surface receives its distance to the tangent plane at its pixel. On a curved
//! surface seen obliquely, this differs from the distance to the surface, by an amount quadratic in the
//! lateral offset between voxel and pixel.

use crate::base::by_processor::by_processor;

/// Cell side in pixels, and distance in cells between the three cells that are compared.
pub const CELL_PIXELS: usize = 4;
const CELL_DISTANCE: usize = 3;
/// Inverse depth is linear on a plane. Limits on the change of its slope, relative to the slope: up to
/// `MAX_PLANAR_CHANGE` the surface counts as planar, from `MIN_CURVED_CHANGE` on as curved.
const MAX_PLANAR_CHANGE: f32 = 0.1;
const MIN_CURVED_CHANGE: f32 = 0.3;

/// Planarity of each cell of 4 × 4 pixels: 1 for a plane, 0 for a curved surface or if it cannot be measured.
#[derive(Debug)]
pub struct Planarity {
    cells: Vec<f32>,
    columns: usize,
}

impl Planarity {
    /// Measure the planarity of a depth map (row by row, not positive where missing).
    pub fn new(depth: &[f32], width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(CELL_PIXELS), height.div_ceil(CELL_PIXELS));
        let inverse = mean_inverse_depth(depth, width, height);
        let mut cells = vec![0.0; columns * rows];
        for y in 0..rows {
            for x in 0..columns {
                let at = y * columns + x;
                let along = |place: usize, count: usize, step: usize| {
                    let is_inside = place >= CELL_DISTANCE && place + CELL_DISTANCE < count;
                    is_inside.then(|| {
                        [inverse[at - CELL_DISTANCE * step], inverse[at], inverse[at + CELL_DISTANCE * step]]
                    })
                };
                if let (Some(across), Some(down)) = (along(x, columns, 1), along(y, rows, columns)) {
                    cells[at] = planarity(across, down);
                }
            }
        }
        Self { cells, columns }
    }

    /// Return the planarity of the cells in a row of pixels.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.cells[y / CELL_PIXELS * self.columns..][..self.columns]
    }
}

/// Average the inverse depth of each cell; NaN if a pixel is missing.
fn mean_inverse_depth(depth: &[f32], width: usize, height: usize) -> Vec<f32> {
    let columns = width.div_ceil(CELL_PIXELS);
    let mut means = vec![0.0; columns * height.div_ceil(CELL_PIXELS)];
    let mut inverse = vec![0.0; columns * CELL_PIXELS];
    for (y, row) in depth.chunks(width.max(1)).enumerate() {
        add_row(row, &mut inverse, &mut means[y / CELL_PIXELS * columns..][..columns]);
    }
    // Incomplete cells at the right and lower border get wrong means, but are never compared on both sides.
    means.iter_mut().for_each(|mean| *mean /= (CELL_PIXELS * CELL_PIXELS) as f32);
    means
}

by_processor! {
    fn add_row(depth: &[f32], inverse: &mut [f32], sums: &mut [f32]) = add_inverse_depth
}

#[inline(always)]
fn add_inverse_depth(depth: &[f32], inverse: &mut [f32], sums: &mut [f32]) {
    for (inverse, &z) in inverse.iter_mut().zip(depth) {
        *inverse = if z > 0.0 { 1.0 / z } else { f32::NAN };
    }
    for (sum, cell) in sums.iter_mut().zip(inverse.chunks_exact(CELL_PIXELS)) {
        *sum += cell[0] + cell[1] + cell[2] + cell[3];
    }
}

/// Compute the planarity from three inverse depths along x and three along y.
fn planarity(across: [f32; 3], down: [f32; 3]) -> f32 {
    let bend = |[a, b, c]: [f32; 3]| a + c - 2.0 * b;
    let slope = |[a, _, c]: [f32; 3]| (c - a) / 2.0;
    let bends = bend(across) * bend(across) + bend(down) * bend(down);
    let slopes = slope(across) * slope(across) + slope(down) * slope(down);
    let share = (bends / slopes).sqrt();
    let flat = (MIN_CURVED_CHANGE - share) / (MIN_CURVED_CHANGE - MAX_PLANAR_CHANGE);
    // NaN counts as not planar.
    if flat > 0.0 { flat.min(1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 64;

    fn map(depth: impl Fn(f32, f32) -> f32) -> Planarity {
        let at = |i: usize| ((i % SIZE) as f32 / 60.0 - 0.5, (i / SIZE) as f32 / 60.0 - 0.5);
        let depth: Vec<f32> = (0..SIZE * SIZE).map(|i| depth(at(i).0, at(i).1)).collect();
        Planarity::new(&depth, SIZE, SIZE)
    }

    /// Cells without the border, where planarity is not measured.
    fn inner(flatness: &Planarity) -> Vec<f32> {
        let cells = SIZE / CELL_PIXELS;
        (CELL_DISTANCE..cells - CELL_DISTANCE)
            .flat_map(|y| flatness.row(y * CELL_PIXELS)[CELL_DISTANCE..cells - CELL_DISTANCE].to_vec())
            .collect()
    }

    #[test]
    fn planes_are_flat_however_obliquely_they_are_seen() {
        for slope in [0.3, 1.0, 1.9] {
            assert!(inner(&map(|x, y| 2.0 / (1.0 + slope * y - 0.1 * x))).iter().all(|&flat| flat > 0.99));
        }
    }

    #[test]
    fn balls_are_not_where_they_are_seen_obliquely() {
        let ball = map(|x, y| 3.0 - (0.6f32.powi(2) - x * x - y * y).max(0.0).sqrt());
        let row = &ball.row(SIZE / 2)[CELL_DISTANCE..SIZE / CELL_PIXELS - CELL_DISTANCE];
        assert!(row.iter().all(|&flat| flat < 0.01), "{row:?}");
    }

    #[test]
    fn what_cannot_be_told_is_not_flat() {
        let holed = map(|x, y| if x.abs() < 0.02 { 0.0 } else { 2.0 / (1.0 + y) });
        // The hole, and the cells compared with it.
        let row = holed.row(SIZE / 2);
        assert!(
            row[SIZE / CELL_PIXELS / 2 - CELL_DISTANCE - 2] > 0.99 && row[SIZE / CELL_PIXELS / 2 - 1] == 0.0
        );
        assert_eq!((row[0], row[CELL_DISTANCE - 1]), (0.0, 0.0));
        assert_eq!(Planarity::new(&[1.0; 6], 3, 2).row(1), [0.0]);
    }
}
