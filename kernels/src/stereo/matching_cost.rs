//! Matching cost between a pixel of the left and a pixel of the right image: census and gradient.
//!
//! The census transform (Zabih and Woodfill, "Non-parametric local transforms for computing visual
//! correspondence", 1994) is invariant to changes of brightness, but uninformative in nearly uniform areas.
//! The gradient difference complements it there.

use super::cost_volume::{DisparityRange, ImageSize, LANES, RgbImage};
use crate::base::by_processor::by_processor;
use crate::base::parallel::for_each_part;

/// Half width and half height of the census window in pixels; the census has one bit per pixel except the
/// centre.
const CENSUS_RADIUS: [i32; 2] = [3, 2];
const CENSUS_BITS: i32 = (2 * CENSUS_RADIUS[0] + 1) * (2 * CENSUS_RADIUS[1] + 1) - 1;
/// Cost if all census bits differ, and if the gradients differ by `MAX_GRADIENT` levels or more.
const CENSUS_WEIGHT: i32 = 120;
const GRADIENT_WEIGHT: i32 = 20;
const MAX_GRADIENT: i32 = 40;
/// Cost per census bit and per gradient level, in 1/256.
const COST_PER_BIT: i32 = CENSUS_WEIGHT * 256 / CENSUS_BITS;
const COST_PER_LEVEL: i32 = GRADIENT_WEIGHT * 256 / MAX_GRADIENT;
/// Cost of a disparity outside the right image: half of the maximum.
const OUTSIDE_COST: i16 = ((CENSUS_WEIGHT + GRADIENT_WEIGHT) / 2) as i16;

/// Convert RGB to brightness (ITU-R BT.601).
pub fn to_grey(image: &RgbImage) -> Vec<u8> {
    image
        .iter()
        .map(|&[r, g, b]| ((77 * r as u32 + 150 * g as u32 + 29 * b as u32 + 128) >> 8) as u8)
        .collect()
}

/// Census and gradient of one image.
pub struct DescribedImage {
    pub census: Vec<u64>,
    /// Central differences over two pixels, along x and y.
    pub gradient: Vec<[i16; 2]>,
}

/// Compute the census and gradient of a grey image; the border pixels are replicated outwards.
pub fn describe_image(grey: &[u8], size: ImageSize, threads: usize) -> DescribedImage {
    let mut census = vec![0u64; size.pixel_count()];
    let mut gradient = vec![[0i16; 2]; size.pixel_count()];
    let rows = census.chunks_mut(size.width).zip(gradient.chunks_mut(size.width)).enumerate().collect();
    for_each_part(rows, threads, |(y, (census, gradient)): (usize, (&mut [u64], &mut [[i16; 2]]))| {
        let around: [Vec<u8>; CENSUS_ROWS] = std::array::from_fn(|row| {
            let v = (y + row).saturating_sub(CENSUS_RADIUS[1] as usize).min(size.height - 1);
            let line = &grey[v * size.width..][..size.width];
            let (before, after) =
                ([line[0]; CENSUS_RADIUS[0] as usize], [line[size.width - 1]; CENSUS_RADIUS[0] as usize]);
            [&before, line, &after].concat()
        });
        describe_row(&around, census, gradient);
    });
    DescribedImage { census, gradient }
}

/// Rows of the census window.
const CENSUS_ROWS: usize = 2 * CENSUS_RADIUS[1] as usize + 1;

by_processor! {
    fn describe_row(around: &[Vec<u8>; CENSUS_ROWS], census: &mut [u64], gradient: &mut [[i16; 2]]) = describe_pixels
}

#[inline(always)]
fn describe_pixels(around: &[Vec<u8>; CENSUS_ROWS], census: &mut [u64], gradient: &mut [[i16; 2]]) {
    let (width, aside, middle) = (census.len(), CENSUS_RADIUS[0] as usize, CENSUS_ROWS / 2);
    let own = &around[middle][aside..][..width];
    for (row, line) in around.iter().enumerate() {
        for column in 0..=2 * aside {
            if (row, column) != (middle, aside) {
                for ((bits, &level), &own) in census.iter_mut().zip(&line[column..]).zip(own) {
                    *bits = *bits << 1 | u64::from(level < own);
                }
            }
        }
    }
    let across = |ahead: u8, behind: u8| i16::from(ahead) - i16::from(behind);
    for (x, gradient) in gradient.iter_mut().enumerate() {
        let beside = &around[middle][x + aside - 1..][..3];
        let (above, below) = (around[middle - 1][x + aside], around[middle + 1][x + aside]);
        *gradient = [across(beside[2], beside[0]), across(below, above)];
    }
}

/// Compute the cost of a number of differing census bits and gradient levels.
#[inline(always)]
pub fn combine_costs(bits: i32, levels: i32) -> i16 {
    ((bits * COST_PER_BIT + levels.min(MAX_GRADIENT) * COST_PER_LEVEL) >> 8) as i16
}

/// Census and gradient of a row of the right image, reversed, so that indices increase with disparity.
struct RightRow {
    census: Vec<u64>,
    across: Vec<i16>,
    down: Vec<i16>,
}

/// Census and gradient of both images of a stereo pair.
pub struct StereoPair {
    left: DescribedImage,
    right: Vec<RightRow>,
    width: usize,
    search: DisparityRange,
}

/// Prepare the matching of two grey images.
pub fn prepare_pair(
    left: &[u8],
    right: &[u8],
    size: ImageSize,
    search: DisparityRange,
    threads: usize,
) -> StereoPair {
    let (left, right) = (describe_image(left, size, threads), describe_image(right, size, threads));
    let rows = right.census.chunks(size.width).zip(right.gradient.chunks(size.width));
    let right = rows
        .map(|(census, gradient)| RightRow {
            census: census.iter().rev().copied().collect(),
            across: gradient.iter().rev().map(|one| one[0]).collect(),
            down: gradient.iter().rev().map(|one| one[1]).collect(),
        })
        .collect();
    StereoPair { left, right, width: size.width, search }
}

impl StereoPair {
    /// Compute the costs of all pixels of a row at all disparities.
    pub fn fill_row_costs(&self, y: usize, costs: &mut [i16]) {
        let own = y * self.width..(y + 1) * self.width;
        let (census, gradient) = (&self.left.census[own.clone()], &self.left.gradient[own]);
        fill_costs(census, gradient, &self.right[y], self.search, costs);
    }
}

by_processor! {
    fn fill_costs(own_census: &[u64], own_gradient: &[[i16; 2]], facing: &RightRow, search: DisparityRange, row: &mut [i16]) = fill_costs_scalar
}

#[inline(always)]
fn fill_costs_scalar(
    own_census: &[u64],
    own_gradient: &[[i16; 2]],
    facing: &RightRow,
    search: DisparityRange,
    row: &mut [i16],
) {
    let (width, count) = (own_census.len() as i32, search.count);
    debug_assert_eq!(count % LANES, 0);
    for (x, costs) in row.chunks_exact_mut(count).enumerate() {
        // Disparities from `first` to before `end` are inside the right image.
        let before = x as i32 - search.lowest;
        let first = (before - (width - 1)).clamp(0, count as i32) as usize;
        let end = (before + 1).clamp(0, count as i32) as usize;
        if first >= end {
            costs.fill(OUTSIDE_COST);
            continue;
        }
        let start = (width - 1 - before + first as i32) as usize;
        let there = start..start + (end - first);
        let ([own_across, own_down], own) = (own_gradient[x], own_census[x]);
        let (across, down) = (&facing.across[there.clone()], &facing.down[there.clone()]);
        let costs = &mut costs[..];
        for (cost, census) in costs[first..end].iter_mut().zip(&facing.census[there]) {
            *cost = (own ^ census).count_ones() as i16;
        }
        for ((cost, across), down) in costs[first..end].iter_mut().zip(across).zip(down) {
            let levels = (across - own_across).abs() + (down - own_down).abs();
            *cost = combine_costs((*cost).into(), levels.into());
        }
        let (nearest, farthest) = (costs[first].max(OUTSIDE_COST), costs[end - 1].max(OUTSIDE_COST));
        costs[..first].fill(nearest);
        costs[end..].fill(farthest);
    }
}
