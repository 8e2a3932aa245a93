//! Cost aggregation over cross-shaped regions of similar colour (Zhang, Lu and Lafruit, "Cross-based local
//! stereo matching using orthogonal integral images", 2009; arm rule after Mei et al., "On building an
//! accurate stereo matching system on graphics hardware", 2011).

use super::cost_volume::{CostVolume, DisparityRange, ImageSize, RgbImage, allocate_volume};
use crate::base::by_processor::by_processor;
use crate::base::parallel::{collect, for_each_part};

/// Maximum arm length in pixels, and maximum colour difference from the centre in levels; one third of it in
/// the outer half of the arm.
const MAX_ARM: usize = 5;
const MAX_COLOR_DIFFERENCE: u8 = 20;
/// Rows held for vertical averaging (the reach of the arms), and rows per band. Rows near a band border are
/// computed twice.
const HELD_ROWS: usize = 2 * MAX_ARM + 1;
const BAND_ROWS: usize = 64;

/// Arm lengths to the left, to the right, above and below, in pixels.
type CrossArms = [u8; 4];

fn measure_arms(image: &RgbImage, size: ImageSize, threads: usize) -> Vec<CrossArms> {
    let unlike = |i: usize, j: usize| (0..3).map(|c| image[i][c].abs_diff(image[j][c])).max().unwrap_or(0);
    collect(size.pixel_count(), threads, |i| {
        let (x, y) = (i % size.width, i / size.width);
        let room = [x, size.width - 1 - x, y, size.height - 1 - y];
        let step = [-1, 1, -(size.width as isize), size.width as isize];
        std::array::from_fn(|way| {
            let mut reach = 0;
            let mut last = i;
            while reach < MAX_ARM.min(room[way]) {
                let next = last.wrapping_add_signed(step[way]);
                let most = if reach < MAX_ARM / 2 { MAX_COLOR_DIFFERENCE } else { MAX_COLOR_DIFFERENCE / 3 };
                if unlike(i, next) > most || unlike(last, next) > MAX_COLOR_DIFFERENCE {
                    break;
                }
                (last, reach) = (next, reach + 1);
            }
            reach as u8
        })
    })
}

/// Average the costs of all pixels and disparities, first along x and then along y. `fill_row_costs` fills a row of
/// costs; rows are computed on demand, so that only a few unaveraged rows are in memory.
pub fn average_costs(
    image: &RgbImage,
    size: ImageSize,
    search: DisparityRange,
    threads: usize,
    costs_of: impl Fn(usize, &mut [i16]) + Sync,
) -> CostVolume {
    let arms = measure_arms(image, size, threads);
    let long = size.width * search.count;
    let mut volume = allocate_volume(size, search);
    let bands = volume.chunks_mut(BAND_ROWS * long).enumerate().collect();
    for_each_part(bands, threads, |(band, part): (usize, &mut [i16])| {
        let mut one = vec![0; long];
        let mut along_x = vec![0; HELD_ROWS * long];
        let mut next = (band * BAND_ROWS).saturating_sub(MAX_ARM);
        for (row, out) in part.chunks_mut(long).enumerate() {
            let y = band * BAND_ROWS + row;
            while next < (y + MAX_ARM + 1).min(size.height) {
                costs_of(next, &mut one);
                average_row(&one, &arms, size, next, false, &mut along_x[next % HELD_ROWS * long..][..long]);
                next += 1;
            }
            average_row(&along_x, &arms, size, y, true, out);
        }
    });
    volume
}

by_processor! {
    fn average_row(
        costs: &[i16],
        arms: &[CrossArms],
        size: ImageSize,
        y: usize,
        across_rows: bool,
        row: &mut [i16],
    ) = average_row_scalar
}

#[inline(always)]
fn average_row_scalar(
    costs: &[i16],
    arms: &[CrossArms],
    size: ImageSize,
    y: usize,
    across_rows: bool,
    row: &mut [i16],
) {
    let count = row.len() / size.width;
    for (x, out) in row.chunks_exact_mut(count).enumerate() {
        let [left, right, above, below] = arms[y * size.width + x].map(usize::from);
        let (before, after) = if across_rows { (above, below) } else { (left, right) };
        let of = |k: usize| {
            let place =
                if across_rows { (y + k - before) % HELD_ROWS * size.width + x } else { x + k - before };
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
