//! Costs summed along eight paths (Hirschmüller, "Stereo processing by semiglobal matching and mutual information", 2008,
//! equations 11 to 14).

use super::by_processor::by_processor;
use super::volume::{Search, Size, Volume, zeros};
use crate::base::parallel::both;

/// What a change of disparity by one costs, and a larger one where the image is flat. Across an edge of so many levels it
/// costs half of that.
pub const SMALL: i16 = 24;
const LARGE: f32 = 300.0;
const EDGE: f32 = 30.0;

/// What a larger change costs where neighbours differ by so many levels.
pub fn penalties() -> [i16; 256] {
    std::array::from_fn(|levels| ((LARGE / (1.0 + levels as f32 / EDGE)) as i16).max(SMALL + 1))
}

/// Add the costs along all paths to `sums`, a volume of zeros. With two threads, those that go down and those that go up
/// have a volume each meanwhile.
pub fn summed(grey: &[u8], costs: &[i16], size: Size, search: Search, threads: usize, sums: &mut Volume) {
    let penalties = penalties();
    if threads <= 1 {
        sweep(grey, costs, size, search, &penalties, true, sums);
        sweep(grey, costs, size, search, &penalties, false, sums);
        return;
    }
    let mut upwards = zeros(size, search);
    both(
        threads,
        || sweep(grey, costs, size, search, &penalties, false, &mut upwards),
        || sweep(grey, costs, size, search, &penalties, true, sums),
    );
    let part = sums.len().div_ceil(threads);
    let parts = sums.chunks_mut(part).zip(upwards.chunks(part)).collect();
    crate::base::parallel::each(parts, threads, |(sums, more): (&mut [i16], &[i16])| {
        sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
    });
}

by_processor! {
    #[allow(clippy::too_many_arguments)]
    fn sweep(
        grey: &[u8],
        costs: &[i16],
        size: Size,
        search: Search,
        penalties: &[i16; 256],
        down: bool,
        sums: &mut [i16],
    ) = all_rows
}

/// A path's costs at a pixel, between two places that no disparity reaches, and the least of them.
struct Reached {
    costs: Vec<i16>,
    least: Vec<i16>,
}

impl Reached {
    fn new(pixels: usize, count: usize) -> Self {
        Self { costs: vec![i16::MAX; pixels * (count + 2)], least: vec![0; pixels] }
    }
}

/// Four of the paths: from behind in the row, and from the three pixels of the row before.
#[inline(always)]
fn all_rows(
    grey: &[u8],
    costs: &[i16],
    size: Size,
    search: Search,
    penalties: &[i16; 256],
    down: bool,
    sums: &mut [i16],
) {
    let (width, height, count) = (size.width, size.height, search.count);
    let padded = count + 2;
    let mut before: [Reached; 3] = std::array::from_fn(|_| Reached::new(width, count));
    let mut now: [Reached; 3] = std::array::from_fn(|_| Reached::new(width, count));
    let mut behind = [vec![i16::MAX; padded], vec![i16::MAX; padded]];
    for row in 0..height {
        let y = if down { row } else { height - 1 - row };
        let mut least_behind = 0;
        for column in 0..width {
            let x = if down { column } else { width - 1 - column };
            let i = y * width + x;
            let (own, sum) = (&costs[i * count..][..count], &mut sums[i * count..][..count]);
            let change = |j: usize| penalties[grey[i].abs_diff(grey[j]) as usize];
            let [first, second] = &mut behind;
            let (last, next) = if column % 2 == 0 { (&*first, second) } else { (&*second, first) };
            least_behind = if column == 0 {
                begin(own, next, sum)
            } else {
                let j = if down { i - 1 } else { i + 1 };
                step(own, last, least_behind, change(j), next, sum)
            };
            for way in 0..3 {
                let from = (x + way).wrapping_sub(1);
                let next = &mut now[way].costs[x * padded..][..padded];
                now[way].least[x] = if row == 0 || from >= width {
                    begin(own, next, sum)
                } else {
                    let j = if down { i - width } else { i + width } + from - x;
                    let last = &before[way];
                    step(own, &last.costs[from * padded..][..padded], last.least[from], change(j), next, sum)
                };
            }
        }
        std::mem::swap(&mut before, &mut now);
    }
}

/// The first pixel of a path.
#[inline(always)]
fn begin(own: &[i16], next: &mut [i16], sum: &mut [i16]) -> i16 {
    let mut least = i16::MAX;
    for ((cost, next), sum) in own.iter().zip(&mut next[1..]).zip(sum) {
        (*next, *sum, least) = (*cost, *sum + cost, least.min(*cost));
    }
    least
}

/// One pixel further: the costs there, which are added to the sums; the least of them is returned.
#[inline(always)]
fn step(own: &[i16], last: &[i16], least_last: i16, change: i16, next: &mut [i16], sum: &mut [i16]) -> i16 {
    let count = own.len();
    let (last, next, sum) = (&last[..count + 2], &mut next[1..=count], &mut sum[..count]);
    let jump = least_last + change;
    let mut least = i16::MAX;
    for d in 0..count {
        let beside = last[d].min(last[d + 2]).saturating_add(SMALL);
        let cost = last[d + 1].min(beside).min(jump) - least_last + own[d];
        next[d] = cost;
        sum[d] += cost;
        least = least.min(cost);
    }
    least
}
