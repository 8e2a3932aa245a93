//! Winner-take-all disparity of each pixel, with confidence measures.

use super::cost_volume::{DisparityRange, ImageSize};
use crate::base::by_processor::by_processor;
use crate::base::parallel::for_each_part;

/// Matching result.
#[derive(Clone, Debug, Default)]
pub struct StereoMatch {
    /// Disparity of each left pixel, in pixels with a fraction.
    pub disparity: Vec<f32>,
    /// Disparity of each right pixel in whole pixels; NaN if no left pixel maps to it.
    pub right_disparity: Vec<f32>,
    /// Path sum of the best disparity, its margin to the best sum of non-adjacent disparities, and its
    /// matching cost.
    pub sum: Vec<i16>,
    pub margin: Vec<i16>,
    pub cost: Vec<i16>,
}

/// One row of each result.
struct ResultRow<'a> {
    disparity: &'a mut [f32],
    of_right: &'a mut [f32],
    sum: &'a mut [i16],
    margin: &'a mut [i16],
    cost: &'a mut [i16],
}

/// Select the disparity with the minimum sum at each pixel. Disparities of the right image come from the
/// diagonals of the same sums.
pub fn select_disparities(
    sums: &[i16],
    costs: &[i16],
    size: ImageSize,
    search: DisparityRange,
    threads: usize,
) -> StereoMatch {
    let pixels = size.pixel_count();
    let mut found = StereoMatch {
        disparity: vec![0.0; pixels],
        right_disparity: vec![f32::NAN; pixels],
        sum: vec![0; pixels],
        margin: vec![0; pixels],
        cost: vec![0; pixels],
    };
    let width = size.width;
    let parts = found
        .disparity
        .chunks_mut(width)
        .zip(found.right_disparity.chunks_mut(width))
        .zip(found.sum.chunks_mut(width))
        .zip(found.margin.chunks_mut(width))
        .zip(found.cost.chunks_mut(width))
        .map(|((((disparity, of_right), sum), margin), cost)| ResultRow {
            disparity,
            of_right,
            sum,
            margin,
            cost,
        });
    for_each_part(parts.enumerate().collect(), threads, |(y, row): (usize, ResultRow<'_>)| {
        let start = y * width * search.count;
        let end = start + width * search.count;
        row.select_row(&sums[start..end], &costs[start..end], search);
    });
    found
}

impl ResultRow<'_> {
    fn select_row(self, sums: &[i16], costs: &[i16], search: DisparityRange) {
        let (width, count) = (self.disparity.len(), search.count);
        // Minimum sum of each right pixel, and its disparity. Reversed, so that indices increase with
        // disparity.
        let (mut least, mut of_least) = (vec![i16::MAX; width], vec![-1i16; width]);
        for (x, sums) in sums.chunks_exact(count).enumerate() {
            let before = x as i32 - search.lowest;
            let first = (before - (width as i32 - 1)).clamp(0, count as i32) as usize;
            let end = (before + 1).clamp(0, count as i32) as usize;
            if first < end {
                let there = (width as i32 - 1 - before + first as i32) as usize;
                keep_minimum(&sums[first..end], first as i16, &mut least[there..], &mut of_least[there..]);
            }
            let (best, margin) = best_and_margin(sums);
            self.disparity[x] = (best as i32 + search.lowest) as f32 + subpixel_offset(sums, best);
            self.sum[x] = sums[best];
            self.margin[x] = margin;
            self.cost[x] = costs[x * count + best];
        }
        for (of_right, &d) in self.of_right.iter_mut().rev().zip(&of_least) {
            if d >= 0 {
                *of_right = (i32::from(d) + search.lowest) as f32;
            }
        }
    }
}

by_processor! {
    fn keep_minimum(sums: &[i16], first: i16, least: &mut [i16], of_least: &mut [i16]) = keep_minimum_scalar
}

/// Keep each sum, for disparities from `first` on, if it is below the current minimum.
#[inline(always)]
fn keep_minimum_scalar(sums: &[i16], first: i16, least: &mut [i16], of_least: &mut [i16]) {
    for (d, ((&sum, least), of_least)) in (first..).zip(sums.iter().zip(least).zip(of_least)) {
        let is_less = sum < *least;
        *of_least = if is_less { d } else { *of_least };
        *least = if is_less { sum } else { *least };
    }
}

/// Return the index of the first minimum sum, and its margin to the minimum of the non-adjacent sums.
pub fn best_and_margin(sums: &[i16]) -> (usize, i16) {
    let least = sums.iter().copied().min().unwrap_or(0);
    let best = sums.iter().position(|&sum| sum == least).unwrap_or(0);
    let other = |part: &[i16]| part.iter().copied().min().unwrap_or(i16::MAX);
    let second = other(&sums[..best.saturating_sub(1)]).min(other(&sums[(best + 2).min(sums.len())..]));
    (best, second.saturating_sub(least))
}

/// Find the minimum of the parabola through the best sum and its neighbours, as an offset of −0.5 to 0.5.
pub fn subpixel_offset(sums: &[i16], best: usize) -> f32 {
    if best == 0 || best + 1 == sums.len() {
        return 0.0;
    }
    let [before, own, after] = [sums[best - 1], sums[best], sums[best + 1]].map(f32::from);
    let bend = before + after - 2.0 * own;
    if bend > 0.0 { ((before - after) / (2.0 * bend)).clamp(-0.5, 0.5) } else { 0.0 }
}
