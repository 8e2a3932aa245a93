//! Cost aggregation over cross-shaped regions of similar colour (Zhang, Lu and Lafruit, "Cross-based local
//! stereo matching using orthogonal integral images", 2009; arm rule after Mei et al., "On building an
//! accurate stereo matching system on graphics hardware", 2011).

use super::volume::{Pixels, Search, Size, Volume, zeros};
use crate::base::by_processor::by_processor;
use crate::base::parallel::{collect, each};

/// Maximum arm length in pixels, and maximum colour difference from the centre in levels; one third of it in
/// the outer half of the arm.
const ARM: usize = 5;
const LIKE: u8 = 20;
/// Rows held for vertical averaging (the reach of the arms), and rows per band. Rows near a band border are
/// computed twice.
const HELD: usize = 2 * ARM + 1;
const BAND: usize = 64;

/// Arm lengths to the left, to the right, above and below, in pixels.
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

/// Average the costs of all pixels and disparities, first along x and then along y. `costs_of` fills a row of
/// costs; rows are computed on demand, so that only a few unaveraged rows are in memory.
pub fn averaged(
    image: &Pixels,
    size: Size,
    search: Search,
    threads: usize,
    costs_of: impl Fn(usize, &mut [i16]) + Sync,
) -> Volume {
    let arms = arms(image, size, threads);
    let long = size.width * search.count;
    let mut volume = zeros(size, search);
    let bands = volume.chunks_mut(BAND * long).enumerate().collect();
    each(bands, threads, |(band, part): (usize, &mut [i16])| {
        let mut one = vec![0; long];
        let mut along_x = vec![0; HELD * long];
        let mut next = (band * BAND).saturating_sub(ARM);
        for (row, out) in part.chunks_mut(long).enumerate() {
            let y = band * BAND + row;
            while next < (y + ARM + 1).min(size.height) {
                costs_of(next, &mut one);
                averages_of_row(&one, &arms, size, next, false, &mut along_x[next % HELD * long..][..long]);
                next += 1;
            }
            averages_of_row(&along_x, &arms, size, y, true, out);
        }
    });
    volume
}

by_processor! {
    fn averages_of_row(
        costs: &[i16],
        arms: &[Arms],
        size: Size,
        y: usize,
        across_rows: bool,
        row: &mut [i16],
    ) = of_row
}

#[inline(always)]
fn of_row(costs: &[i16], arms: &[Arms], size: Size, y: usize, across_rows: bool, row: &mut [i16]) {
    let count = row.len() / size.width;
    for (x, out) in row.chunks_exact_mut(count).enumerate() {
        let [left, right, above, below] = arms[y * size.width + x].map(usize::from);
        let (before, after) = if across_rows { (above, below) } else { (left, right) };
        let of = |k: usize| {
            let place = if across_rows { (y + k - before) % HELD * size.width + x } else { x + k - before };
            &costs[place * count..][..count]
        };
        out.copy_from_slice(of(0));
        for k in 1..=before + after {
            for (sum, cost) in out.iter_mut().zip(of(k)) {
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
