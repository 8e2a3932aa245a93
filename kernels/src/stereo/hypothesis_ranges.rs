//! Cost volume with a separate range of hypotheses per pixel, so that a coarse search can restrict a finer
//! one (Rothermel et al., "SURE: Photogrammetric surface reconstruction from imagery", 2012).

use std::ops::Range;

use super::cost_volume::{ImageSize, LANES};
use super::path_aggregation::{Hypotheses, PathInput, UNREACHABLE_COST, aggregate_rows};
use crate::base::by_processor::by_processor;

/// Per pixel: first hypothesis, number of hypotheses (a multiple of [`LANES`]), and start index of its
/// values.
#[derive(Clone, Debug)]
pub struct HypothesisRanges {
    pub first: Vec<i32>,
    pub count: Vec<u16>,
    starts: Vec<usize>,
    widest: usize,
}

impl HypothesisRanges {
    /// Create ranges from the first hypothesis and the count of each pixel.
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

    /// Return the number of values of all pixels.
    pub fn value_count(&self) -> usize {
        self.starts[self.count.len()]
    }

    /// Split a volume into its rows, with their row indices.
    pub fn split_rows<'a>(&self, mut volume: &'a mut [i16], size: ImageSize) -> Vec<(usize, &'a mut [i16])> {
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

impl Hypotheses for HypothesisRanges {
    #[inline(always)]
    fn range_of(&self, pixel: usize) -> Range<usize> {
        self.starts[pixel]..self.starts[pixel + 1]
    }

    fn max_count(&self) -> usize {
        self.widest
    }

    /// Hypotheses outside the other pixel's range can only be reached by a jump (penalty P2).
    #[inline(always)]
    fn align_costs<'a>(&self, last: &'a [i16], j: usize, i: usize, room: &'a mut [i16]) -> &'a [i16] {
        let (here, there) = (i64::from(self.count[i]) + 2, i64::from(self.count[j]));
        // Position of the other pixel's first hypothesis.
        let shift = i64::from(self.first[j]) - i64::from(self.first[i]) + 1;
        let begin = shift.clamp(0, here);
        let end = (shift + there).clamp(begin, here);
        let skipped = (begin - shift) as usize + 1;
        let (begin, end) = (begin as usize, end as usize);
        let room = &mut room[..here as usize];
        room[..begin].fill(UNREACHABLE_COST);
        if end > begin {
            room[begin..end].copy_from_slice(&last[skipped..skipped + end - begin]);
        }
        room[end..].fill(UNREACHABLE_COST);
        room
    }

    fn aggregate_direction(&self, image: &PathInput<'_>, down: bool, sums: &mut [i16]) {
        aggregate_ranges(self, image, down, sums);
    }
}

by_processor! {
    fn aggregate_ranges(ranges: &HypothesisRanges, image: &PathInput<'_>, down: bool, sums: &mut [i16]) = aggregate_rows
}
