//! Overlap test for the triangles of a growing patch, projected along its normal.

use robust::{Coord, orient2d};

/// No entry.
const NONE: u32 = u32::MAX;

/// Maximum cells per grid side; limits the memory.
const MOST_CELLS: f64 = 4096.0;

/// Triangle in the plane of a patch.
pub type Flat = [[f64; 2]; 3];

/// Set of triangles in a plane that do not overlap, in a uniform grid.
pub struct Sheet {
    low: [f64; 2],
    cell: f64,
    size: [usize; 2],
    /// Linked lists per cell: its first entry; and per entry, the next entry and the triangle.
    first: Vec<u32>,
    entries: Vec<(u32, u32)>,
    /// Triangles, each with true if it is counter-clockwise.
    triangles: Vec<(Flat, bool)>,
}

impl Sheet {
    /// Create a grid for about `count` triangles in a box. Triangles outside the box go to cells at its edge.
    pub fn new(low: [f64; 2], high: [f64; 2], count: usize) -> Self {
        let sides = [0, 1].map(|i| (high[i] - low[i]).max(f64::MIN_POSITIVE));
        let cell = (sides[0] * sides[1] / count.max(1) as f64)
            .sqrt()
            .max(sides[0].max(sides[1]) / MOST_CELLS)
            .max(f64::MIN_POSITIVE);
        let size = sides.map(|side| (side / cell).min(MOST_CELLS) as usize + 1);
        Self { low, cell, size, first: vec![NONE; size[0] * size[1]], entries: vec![], triangles: vec![] }
    }

    /// Return the ranges of columns and rows that a triangle's bounding box covers.
    fn cells(&self, triangle: &Flat) -> [[usize; 2]; 2] {
        let place =
            |x: f64, i: usize| (((x - self.low[i]) / self.cell).max(0.0) as usize).min(self.size[i] - 1);
        [0, 1].map(|i| span(triangle, i).map(|x| place(x, i)))
    }

    /// Add a counter-clockwise triangle. Returns false if it overlaps another one.
    pub fn add(&mut self, triangle: Flat) -> bool {
        let [columns, rows] = self.cells(&triangle);
        let is_sound = turn(triangle) > 0.0;
        for y in rows[0]..=rows[1] {
            for x in columns[0]..=columns[1] {
                let mut entry = self.first[y * self.size[0] + x];
                while entry != NONE {
                    let (next, number) = self.entries[entry as usize];
                    let (other, is_other_sound) = &self.triangles[number as usize];
                    // For two triangles with area, disjoint boxes exclude an overlap; this test is exact.
                    let are_apart = is_sound && *is_other_sound && are_apart(&triangle, other);
                    if !are_apart && lie_over(&triangle, other) {
                        return false;
                    }
                    entry = next;
                }
            }
        }
        let number = self.triangles.len() as u32;
        for y in rows[0]..=rows[1] {
            for x in columns[0]..=columns[1] {
                let first = &mut self.first[y * self.size[0] + x];
                self.entries.push((*first, number));
                *first = self.entries.len() as u32 - 1;
            }
        }
        self.triangles.push((triangle, is_sound));
        true
    }
}

/// Compute the minimum and maximum of a coordinate.
fn span(triangle: &Flat, i: usize) -> [f64; 2] {
    triangle.iter().fold([f64::MAX, f64::MIN], |[low, high], p| [low.min(p[i]), high.max(p[i])])
}

/// Check whether the bounding boxes of two triangles are disjoint or only touch.
fn are_apart(a: &Flat, b: &Flat) -> bool {
    (0..2).any(|i| {
        let (a, b) = (span(a, i), span(b, i));
        a[1] <= b[0] || b[1] <= a[0]
    })
}

fn coordinate(p: [f64; 2]) -> Coord<f64> {
    Coord { x: p[0], y: p[1] }
}

/// Compute the exact orientation of a triangle; positive if counter-clockwise.
fn turn(triangle: Flat) -> f64 {
    let [a, b, c] = triangle.map(coordinate);
    orient2d(a, b, c)
}

/// Check exactly whether two triangles overlap: no side of either separates them.
fn lie_over(a: &Flat, b: &Flat) -> bool {
    let parts = |a: &Flat, b: &Flat| {
        (0..3).any(|i| {
            let (p, q) = (coordinate(a[i]), coordinate(a[(i + 1) % 3]));
            b.iter().all(|&r| orient2d(p, q, coordinate(r)) <= 0.0)
        })
    };
    !parts(a, b) && !parts(b, a)
}
