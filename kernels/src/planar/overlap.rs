//! Overlap test for the triangles of a growing patch, projected along its normal.

use robust::{Coord, orient2d};

/// No entry.
const NONE: u32 = u32::MAX;

/// Maximum cells per grid side; limits the memory.
const MAX_CELLS: f64 = 4096.0;

/// Triangle in the plane of a patch.
pub type PlaneTriangle = [[f64; 2]; 3];

/// Set of triangles in a plane that do not overlap, in a uniform grid.
pub struct OverlapGrid {
    low: [f64; 2],
    cell: f64,
    size: [usize; 2],
    /// Linked lists per cell: its first entry; and per entry, the next entry and the triangle.
    first: Vec<u32>,
    entries: Vec<(u32, u32)>,
    /// Triangles, each with true if it is counter-clockwise.
    triangles: Vec<(PlaneTriangle, bool)>,
}

impl OverlapGrid {
    /// Create a grid for about `count` triangles in a box. Triangles outside the box go to cells at its edge.
    pub fn new(low: [f64; 2], high: [f64; 2], count: usize) -> Self {
        let sides = [0, 1].map(|i| (high[i] - low[i]).max(f64::MIN_POSITIVE));
        let cell = (sides[0] * sides[1] / count.max(1) as f64)
            .sqrt()
            .max(sides[0].max(sides[1]) / MAX_CELLS)
            .max(f64::MIN_POSITIVE);
        let size = sides.map(|side| (side / cell).min(MAX_CELLS) as usize + 1);
        Self { low, cell, size, first: vec![NONE; size[0] * size[1]], entries: vec![], triangles: vec![] }
    }

    /// Return the ranges of columns and rows that a triangle's bounding box covers.
    fn cell_ranges(&self, triangle: &PlaneTriangle) -> [[usize; 2]; 2] {
        let place =
            |x: f64, i: usize| (((x - self.low[i]) / self.cell).max(0.0) as usize).min(self.size[i] - 1);
        [0, 1].map(|i| coordinate_range(triangle, i).map(|x| place(x, i)))
    }

    /// Add a counter-clockwise triangle. Returns false if it overlaps another one.
    pub fn try_add(&mut self, triangle: PlaneTriangle) -> bool {
        let [columns, rows] = self.cell_ranges(&triangle);
        let is_sound = compute_orientation(triangle) > 0.0;
        for y in rows[0]..=rows[1] {
            for x in columns[0]..=columns[1] {
                let mut entry = self.first[y * self.size[0] + x];
                while entry != NONE {
                    let (next, number) = self.entries[entry as usize];
                    let (other, is_other_sound) = &self.triangles[number as usize];
                    // For two triangles with area, disjoint boxes exclude an overlap; this test is exact.
                    let are_apart = is_sound && *is_other_sound && are_boxes_disjoint(&triangle, other);
                    if !are_apart && do_overlap(&triangle, other) {
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
fn coordinate_range(triangle: &PlaneTriangle, i: usize) -> [f64; 2] {
    triangle.iter().fold([f64::MAX, f64::MIN], |[low, high], p| [low.min(p[i]), high.max(p[i])])
}

/// Check whether the bounding boxes of two triangles are disjoint or only touch.
fn are_boxes_disjoint(a: &PlaneTriangle, b: &PlaneTriangle) -> bool {
    (0..2).any(|i| {
        let (a, b) = (coordinate_range(a, i), coordinate_range(b, i));
        a[1] <= b[0] || b[1] <= a[0]
    })
}

fn to_coord(p: [f64; 2]) -> Coord<f64> {
    Coord { x: p[0], y: p[1] }
}

/// Compute the exact orientation of a triangle; positive if counter-clockwise.
fn compute_orientation(triangle: PlaneTriangle) -> f64 {
    let [a, b, c] = triangle.map(to_coord);
    orient2d(a, b, c)
}

/// Check exactly whether two triangles overlap: no side of either separates them.
fn do_overlap(a: &PlaneTriangle, b: &PlaneTriangle) -> bool {
    let parts = |a: &PlaneTriangle, b: &PlaneTriangle| {
        (0..3).any(|i| {
            let (p, q) = (to_coord(a[i]), to_coord(a[(i + 1) % 3]));
            b.iter().all(|&r| orient2d(p, q, to_coord(r)) <= 0.0)
        })
    };
    !parts(a, b) && !parts(b, a)
}
