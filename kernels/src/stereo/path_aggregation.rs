//! Aggregation of costs along eight paths (Hirschmüller, "Stereo processing by semiglobal matching and mutual
//! information", 2008, equations 11 to 14).

use std::ops::Range;

use super::cost_volume::{DisparityRange, ImageSize};
use crate::base::by_processor::by_processor;
use crate::base::parallel::run_concurrently;

/// Penalties P1 for a disparity change of one, and P2 for larger changes in uniform areas, in cost units. P2
/// halves at a brightness difference of `EDGE_LEVELS` grey levels.
const SMALL_CHANGE_PENALTY: i16 = 24;
const LARGE_CHANGE_PENALTY: f32 = 300.0;
const EDGE_LEVELS: f32 = 30.0;

/// Larger than any path cost, and small enough not to overflow.
pub const UNREACHABLE_COST: i16 = i16::MAX / 2;

/// Input of the path aggregation.
pub struct PathInput<'a> {
    pub grey: &'a [u8],
    pub size: ImageSize,
    /// Cost volume.
    pub costs: &'a [i16],
    penalties: [i16; 256],
}

/// Hypotheses of each pixel: disparities, or depth planes.
pub trait Hypotheses: Sync {
    /// Return the index range of a pixel's values in a volume.
    fn range_of(&self, pixel: usize) -> Range<usize>;

    /// Return the maximum number of hypotheses of a pixel.
    fn max_count(&self) -> usize;

    /// Align the path costs `last` of pixel `j` with the hypotheses of pixel `i`, with one more on either
    /// side. `last` is padded with [`UNREACHABLE_COST`] at both ends. `room` is a buffer for costs that must be shifted.
    fn align_costs<'a>(&self, last: &'a [i16], j: usize, i: usize, room: &'a mut [i16]) -> &'a [i16];

    /// Run [`aggregate_rows`] in the widest instructions of the processor.
    fn aggregate_direction(&self, image: &PathInput<'_>, down: bool, sums: &mut [i16]);
}

impl Hypotheses for DisparityRange {
    #[inline(always)]
    fn range_of(&self, pixel: usize) -> Range<usize> {
        pixel * self.count..(pixel + 1) * self.count
    }

    fn max_count(&self) -> usize {
        self.count
    }

    #[inline(always)]
    fn align_costs<'a>(&self, last: &'a [i16], _: usize, _: usize, _: &'a mut [i16]) -> &'a [i16] {
        last
    }

    fn aggregate_direction(&self, image: &PathInput<'_>, down: bool, sums: &mut [i16]) {
        aggregate_disparities(self, image, down, sums);
    }
}

by_processor! {
    fn aggregate_disparities(search: &DisparityRange, image: &PathInput<'_>, down: bool, sums: &mut [i16]) = aggregate_rows
}

/// Tabulate the penalty P2 by the brightness difference of neighbours.
fn penalty_table() -> [i16; 256] {
    std::array::from_fn(|levels| {
        ((LARGE_CHANGE_PENALTY / (1.0 + levels as f32 / EDGE_LEVELS)) as i16).max(SMALL_CHANGE_PENALTY + 1)
    })
}

/// Add the path costs of all eight directions to `sums`, a volume of zeros. With two or more threads,
/// downward and upward paths run concurrently, each with a separate volume.
pub fn aggregate_paths(
    grey: &[u8],
    costs: &[i16],
    size: ImageSize,
    hypotheses: &impl Hypotheses,
    threads: usize,
    sums: &mut [i16],
) {
    let image = PathInput { grey, size, costs, penalties: penalty_table() };
    if threads <= 1 {
        hypotheses.aggregate_direction(&image, true, sums);
        hypotheses.aggregate_direction(&image, false, sums);
        return;
    }
    let mut upwards = vec![0; sums.len()];
    run_concurrently(
        threads,
        || hypotheses.aggregate_direction(&image, false, &mut upwards),
        || hypotheses.aggregate_direction(&image, true, sums),
    );
    let part = sums.len().div_ceil(threads);
    let parts = sums.chunks_mut(part).zip(upwards.chunks(part)).collect();
    crate::base::parallel::for_each_part(parts, threads, |(sums, more): (&mut [i16], &[i16])| {
        sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
    });
}

/// Path costs of a row's pixels, each padded with [`UNREACHABLE_COST`] at both ends, and their minimum per pixel.
struct PathCosts {
    costs: Vec<i16>,
    least: Vec<i16>,
}

/// Aggregate four of the paths: from the previous pixel in the row, and from three pixels of the previous
/// row.
#[inline(always)]
pub fn aggregate_rows(hypotheses: &impl Hypotheses, image: &PathInput<'_>, down: bool, sums: &mut [i16]) {
    let PathInput { grey, size, costs, penalties } = image;
    let (width, height) = (size.width, size.height);
    let padded = hypotheses.max_count() + 2;
    let reached = || PathCosts { costs: vec![UNREACHABLE_COST; width * padded], least: vec![0; width] };
    let mut before: [PathCosts; 3] = std::array::from_fn(|_| reached());
    let mut now: [PathCosts; 3] = std::array::from_fn(|_| reached());
    let mut behind = [vec![UNREACHABLE_COST; padded], vec![UNREACHABLE_COST; padded]];
    let mut room = vec![UNREACHABLE_COST; padded];
    for row in 0..height {
        let y = if down { row } else { height - 1 - row };
        let mut least_behind = 0;
        for column in 0..width {
            let x = if down { column } else { width - 1 - column };
            let i = y * width + x;
            let (own, sum) = (&costs[hypotheses.range_of(i)], &mut sums[hypotheses.range_of(i)]);
            let change = |j: usize| penalties[grey[i].abs_diff(grey[j]) as usize];
            let [first, second] = &mut behind;
            let (last, next) = if column % 2 == 0 { (&*first, second) } else { (&*second, first) };
            least_behind = if column == 0 {
                start_path(own, next, sum)
            } else {
                let j = if down { i - 1 } else { i + 1 };
                let last = hypotheses.align_costs(last, j, i, &mut room);
                extend_path(own, last, least_behind, change(j), next, sum)
            };
            for way in 0..3 {
                let from = (x + way).wrapping_sub(1);
                let next = &mut now[way].costs[x * padded..][..padded];
                now[way].least[x] = if row == 0 || from >= width {
                    start_path(own, next, sum)
                } else {
                    let j = if down { i - width } else { i + width } + from - x;
                    let last = &before[way].costs[from * padded..][..padded];
                    let last = hypotheses.align_costs(last, j, i, &mut room);
                    extend_path(own, last, before[way].least[from], change(j), next, sum)
                };
            }
        }
        std::mem::swap(&mut before, &mut now);
    }
}

/// Start a path at a pixel; return the minimum cost.
#[inline(always)]
fn start_path(own: &[i16], next: &mut [i16], sum: &mut [i16]) -> i16 {
    let mut least = i16::MAX;
    for ((cost, next), sum) in own.iter().zip(&mut next[1..]).zip(sum) {
        (*next, *sum, least) = (*cost, *sum + cost, least.min(*cost));
    }
    least
}

/// Extend a path by one pixel and add its costs to the sums; return the minimum cost.
#[inline(always)]
fn extend_path(
    own: &[i16],
    last: &[i16],
    least_last: i16,
    change: i16,
    next: &mut [i16],
    sum: &mut [i16],
) -> i16 {
    let count = own.len();
    let (last, next, sum) = (&last[..count + 2], &mut next[1..=count], &mut sum[..count]);
    let jump = least_last + change;
    let mut least = i16::MAX;
    for d in 0..count {
        let beside = last[d].min(last[d + 2]) + SMALL_CHANGE_PENALTY;
        let cost = last[d + 1].min(beside).min(jump) - least_last + own[d];
        next[d] = cost;
        sum[d] += cost;
        least = least.min(cost);
    }
    least
}
