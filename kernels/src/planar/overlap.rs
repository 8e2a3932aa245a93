//! Which triangles of a growing patch lie over each other, seen along its normal.

use robust::{Coord, orient2d};

/// No entry.
const NONE: u32 = u32::MAX;

/// Cells along a side of the grid, at most.
const MOST_CELLS: f64 = 4096.0;

pub type Flat = [[f64; 2]; 3];

/// Triangles in a plane that have no point in common but on their sides.
pub struct Sheet {
    low: [f64; 2],
    cell: f64,
    size: [usize; 2],
    /// First entry of each cell, and for each entry the next of its cell and its triangle.
    first: Vec<u32>,
    entries: Vec<(u32, u32)>,
    triangles: Vec<Flat>,
}

impl Sheet {
    /// For about so many triangles in a box; what is beyond it goes to the cells at its rim.
    pub fn new(low: [f64; 2], high: [f64; 2], count: usize) -> Self {
        let sides = [0, 1].map(|i| (high[i] - low[i]).max(f64::MIN_POSITIVE));
        let cell = (sides[0] * sides[1] / count.max(1) as f64)
            .sqrt()
            .max(sides[0].max(sides[1]) / MOST_CELLS)
            .max(f64::MIN_POSITIVE);
        let size = sides.map(|side| (side / cell).min(MOST_CELLS) as usize + 1);
        Self { low, cell, size, first: vec![NONE; size[0] * size[1]], entries: vec![], triangles: vec![] }
    }

    fn cells(&self, triangle: &Flat) -> impl Iterator<Item = usize> + use<> {
        let place =
            |x: f64, i: usize| (((x - self.low[i]) / self.cell).max(0.0) as usize).min(self.size[i] - 1);
        let range = |i: usize| {
            let (low, high) =
                triangle.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p[i]), h.max(p[i])));
            place(low, i)..=place(high, i)
        };
        let (columns, width) = (range(0), self.size[0]);
        range(1).flat_map(move |y| columns.clone().map(move |x| y * width + x))
    }

    /// Add a triangle, counter-clockwise, unless it lies over another.
    pub fn add(&mut self, triangle: Flat) -> bool {
        for cell in self.cells(&triangle) {
            let mut entry = self.first[cell];
            while entry != NONE {
                let (next, other) = self.entries[entry as usize];
                if lie_over(&triangle, &self.triangles[other as usize]) {
                    return false;
                }
                entry = next;
            }
        }
        let number = self.triangles.len() as u32;
        for cell in self.cells(&triangle) {
            self.entries.push((self.first[cell], number));
            self.first[cell] = self.entries.len() as u32 - 1;
        }
        self.triangles.push(triangle);
        true
    }
}

/// Whether no side of either has all of the other on its right; exact.
fn lie_over(a: &Flat, b: &Flat) -> bool {
    let coordinate = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
    let parts = |a: &Flat, b: &Flat| {
        (0..3).any(|i| {
            let (p, q) = (coordinate(a[i]), coordinate(a[(i + 1) % 3]));
            b.iter().all(|&r| orient2d(p, q, coordinate(r)) <= 0.0)
        })
    };
    !parts(a, b) && !parts(b, a)
}
