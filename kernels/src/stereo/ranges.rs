//! A number for each pixel and each of the hypotheses that are tried there: every pixel has a range of its own, so that a
//! coarser search can say where a finer one need look (Rothermel et al., "SURE: Photogrammetric surface reconstruction from
//! imagery", 2012).

use super::volume::{LANES, Size};

/// Of each pixel the first hypothesis and how many there are, a multiple of [`LANES`]; and where its numbers begin.
#[derive(Clone, Debug)]
pub struct Ranges {
    pub first: Vec<i32>,
    pub count: Vec<u16>,
    starts: Vec<usize>,
    pub widest: usize,
}

impl Ranges {
    pub fn new(first: Vec<i32>, count: Vec<u16>) -> Self {
        debug_assert!(count.iter().all(|&n| n > 0 && usize::from(n) % LANES == 0));
        let mut starts = Vec::with_capacity(count.len() + 1);
        let mut all = 0;
        for &n in &count {
            starts.push(all);
            all += usize::from(n);
        }
        starts.push(all);
        let widest = count.iter().copied().max().unwrap_or(0).into();
        Self { first, count, starts, widest }
    }

    /// How many numbers all pixels have.
    pub fn numbers(&self) -> usize {
        self.starts[self.count.len()]
    }

    /// The places of a pixel's numbers.
    pub fn of(&self, pixel: usize) -> std::ops::Range<usize> {
        self.starts[pixel]..self.starts[pixel + 1]
    }

    /// The rows of a volume, with their numbers.
    pub fn rows<'a>(&self, mut volume: &'a mut [i16], size: Size) -> Vec<(usize, &'a mut [i16])> {
        (0..size.height)
            .map(|y| {
                let long = self.starts[(y + 1) * size.width] - self.starts[y * size.width];
                let (row, rest) = std::mem::take(&mut volume).split_at_mut(long);
                volume = rest;
                (y, row)
            })
            .collect()
    }
}
