//! Costs averaged over what is likely of one surface: crosses of pixels of like colour (Zhang, Lu and Lafruit, "Cross-based
//! local stereo matching using orthogonal integral images", 2009; the rule for the arms after Mei et al., "On building an
//! accurate stereo matching system on graphics hardware", 2011).

use super::volume::{Pixels, Search, Size, Volume, rows, zeros};
use crate::base::by_processor::by_processor;
use crate::base::parallel::{collect, each};

/// How far an arm reaches, and by how many levels its pixels may differ from the first one; in its far half by a third.
const ARM: usize = 5;
const LIKE: u8 = 20;

/// Pixels to the left, to the right, above and below.
type Arms = [u8; 4];

fn arms(image: &Pixels, size: Size, threads: usize) -> Vec<Arms> {
    let unlike = |i: usize, j: usize| (0..3).map(|c| image[i][c].abs_diff(image[j][c])).max().unwrap_or(0);
    collect(size.pixels(), threads, |i| {
        let (x, y) = (i % size.width, i / size.width);
        let room = [x, size.width - 1 - x, y, size.height - 1 - y];
        let step = [-1, 1, -(size.width as isize), size.width as isize];
        std::array::from_fn(|way| {
            let mut reach = 0;
            let mut last = i;
            while reach < ARM.min(room[way]) {
                let next = last.wrapping_add_signed(step[way]);
                let most = if reach < ARM / 2 { LIKE } else { LIKE / 3 };
                if unlike(i, next) > most || unlike(last, next) > LIKE {
                    break;
                }
                (last, reach) = (next, reach + 1);
            }
            reach as u8
        })
    })
}

/// Average costs in place, first along x and then along y; the volume that is returned holds zeros.
pub fn averaged(image: &Pixels, costs: &mut Volume, size: Size, search: Search, threads: usize) -> Volume {
    let arms = arms(image, size, threads);
    let mut along_x = zeros(size, search);
    each(rows(&mut along_x, size, search), threads, |(y, row)| {
        averages_of_row(costs, &arms, size, y, 1, row)
    });
    each(rows(costs, size, search), threads, |(y, row)| {
        averages_of_row(&along_x, &arms, size, y, size.width, row);
    });
    each(rows(&mut along_x, size, search), threads, |(_, row)| row.fill(0));
    along_x
}

by_processor! {
    fn averages_of_row(
        costs: &[i16],
        arms: &[Arms],
        size: Size,
        y: usize,
        step: usize,
        row: &mut [i16],
    ) = of_row
}

#[inline(always)]
fn of_row(costs: &[i16], arms: &[Arms], size: Size, y: usize, step: usize, row: &mut [i16]) {
    let count = row.len() / size.width;
    for (x, out) in row.chunks_exact_mut(count).enumerate() {
        let i = y * size.width + x;
        let way = if step == 1 { 0 } else { 2 };
        let (before, after) = (arms[i][way] as usize, arms[i][way + 1] as usize);
        let first = i - before * step;
        out.copy_from_slice(&costs[first * count..][..count]);
        for k in 1..=before + after {
            for (sum, cost) in out.iter_mut().zip(&costs[(first + k * step) * count..][..count]) {
                *sum += cost;
            }
        }
        if before + after > 0 {
            let share = 65536 / (before + after + 1) as u32;
            for sum in out.iter_mut() {
                *sum = ((*sum as u16 as u32 * share) >> 16) as i16;
            }
        }
    }
}
