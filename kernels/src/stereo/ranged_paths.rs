//! Costs summed along eight paths where every pixel has a range of its own: as in [`super::paths`], what a neighbour's range
//! does not hold is reached by a jump alone.

use super::by_processor::by_processor;
use super::paths::{SMALL, penalties};
use super::ranges::Ranges;
use super::volume::Size;

/// More than any cost along a path, and less than would overflow.
const FAR: i16 = i16::MAX / 2;

/// The sums of all pixels and hypotheses.
pub fn summed(grey: &[u8], costs: &[i16], size: Size, ranges: &Ranges) -> Vec<i16> {
    let penalties = penalties();
    let mut sums = vec![0; costs.len()];
    for down in [true, false] {
        sweep(grey, costs, size, ranges, &penalties, down, &mut sums);
    }
    sums
}

by_processor! {
    #[allow(clippy::too_many_arguments)]
    fn sweep(
        grey: &[u8],
        costs: &[i16],
        size: Size,
        ranges: &Ranges,
        penalties: &[i16; 256],
        down: bool,
        sums: &mut [i16],
    ) = all_rows
}

/// A path's costs at a pixel, and the least of them.
struct Reached {
    costs: Vec<i16>,
    least: Vec<i16>,
}

/// Four of the paths: from behind in the row, and from the three pixels of the row before.
#[inline(always)]
fn all_rows(
    grey: &[u8],
    costs: &[i16],
    size: Size,
    ranges: &Ranges,
    penalties: &[i16; 256],
    down: bool,
    sums: &mut [i16],
) {
    let (width, height, wide) = (size.width, size.height, ranges.widest);
    let reached = || Reached { costs: vec![0; (width + 1) * wide], least: vec![0; width] };
    let mut before: [Reached; 3] = std::array::from_fn(|_| reached());
    let mut now: [Reached; 3] = std::array::from_fn(|_| reached());
    let mut behind = [vec![0i16; wide], vec![0i16; wide]];
    // A neighbour's costs as the pixel's own range sees them, with a hypothesis more at either end.
    let mut seen = vec![FAR; wide + 2];
    for row in 0..height {
        let y = if down { row } else { height - 1 - row };
        let mut least_behind = 0;
        for column in 0..width {
            let x = if down { column } else { width - 1 - column };
            let i = y * width + x;
            let own = &costs[ranges.of(i)];
            let sum = &mut sums[ranges.of(i)];
            let change = |j: usize| penalties[grey[i].abs_diff(grey[j]) as usize];
            let [first, second] = &mut behind;
            let (last, next) = if column % 2 == 0 { (&*first, second) } else { (&*second, first) };
            least_behind = if column == 0 {
                begin(own, next, sum)
            } else {
                let j = if down { i - 1 } else { i + 1 };
                align(last, j, i, ranges, &mut seen);
                step(own, &seen, least_behind, change(j), next, sum)
            };
            for way in 0..3 {
                let from = (x + way).wrapping_sub(1);
                let next = &mut now[way].costs[x * wide..][..wide];
                now[way].least[x] = if row == 0 || from >= width {
                    begin(own, next, sum)
                } else {
                    let j = if down { i - width } else { i + width } + from - x;
                    let last = &before[way];
                    align(&last.costs[from * wide..][..wide], j, i, ranges, &mut seen);
                    step(own, &seen, last.least[from], change(j), next, sum)
                };
            }
        }
        std::mem::swap(&mut before, &mut now);
    }
}

/// Put the costs of pixel `j` where the range of pixel `i` has the same hypotheses, one place further.
#[inline(always)]
fn align(last: &[i16], j: usize, i: usize, ranges: &Ranges, seen: &mut [i16]) {
    let (here, there) = (usize::from(ranges.count[i]), usize::from(ranges.count[j]));
    let seen = &mut seen[..here + 2];
    // The place in `seen` of the neighbour's first hypothesis.
    let shift = i64::from(ranges.first[j]) - i64::from(ranges.first[i]) + 1;
    let begin = shift.clamp(0, here as i64 + 2);
    let end = (shift + there as i64).clamp(begin, here as i64 + 2);
    let skipped = (begin - shift) as usize;
    let (begin, end) = (begin as usize, end as usize);
    seen[..begin].fill(FAR);
    if end > begin {
        seen[begin..end].copy_from_slice(&last[skipped..skipped + end - begin]);
    }
    seen[end..].fill(FAR);
}

/// The first pixel of a path.
#[inline(always)]
fn begin(own: &[i16], next: &mut [i16], sum: &mut [i16]) -> i16 {
    let mut least = i16::MAX;
    for ((cost, next), sum) in own.iter().zip(next).zip(sum) {
        (*next, *sum, least) = (*cost, *sum + cost, least.min(*cost));
    }
    least
}

/// One pixel further: the costs there, which are added to the sums; the least of them is returned.
#[inline(always)]
fn step(own: &[i16], last: &[i16], least_last: i16, change: i16, next: &mut [i16], sum: &mut [i16]) -> i16 {
    let count = own.len();
    let (last, next, sum) = (&last[..count + 2], &mut next[..count], &mut sum[..count]);
    let jump = least_last + change;
    let mut least = i16::MAX;
    for d in 0..count {
        let beside = last[d].min(last[d + 2]) + SMALL;
        let cost = last[d + 1].min(beside).min(jump) - least_last + own[d];
        next[d] = cost;
        sum[d] += cost;
        least = least.min(cost);
    }
    least
}
