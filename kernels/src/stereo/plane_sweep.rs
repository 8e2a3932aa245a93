//! Plane sweep: matching cost of a view and its partners for each pixel and depth plane (Collins, "A
//! space-sweep approach to true multi-image matching", 1996).
//!
//! The planes are parallel to the image plane of the view. Each partner image is warped once, by the
//! homography of one plane. Every other plane then maps to it by a scale and a shift.

use super::cost_volume::ImageSize;
use super::hypothesis_ranges::HypothesisRanges;
use super::matching_cost::{combine_costs, describe_image};
use super::path_aggregation::Hypotheses;
use super::winner_take_all::{best_and_margin, subpixel_offset};
use crate::base::by_processor::by_processor;
use crate::base::parallel::{collect, for_each_part};

/// Content of a pixel of a warped partner image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PixelContent {
    /// The pixel is outside the partner image.
    Outside = 0,
    /// The pixel shows the scene.
    Scene = 1,
    /// The pixel is outside the object's silhouette.
    Background = 2,
}

/// Packed pixel descriptor: census, half of the gradient along x and y, and [`PixelContent`].
pub type PixelWord = u64;
const CENSUS_MASK: PixelWord = (1 << 34) - 1;
const ACROSS_SHIFT: u32 = 34;
const DOWN_SHIFT: u32 = 42;
const CONTENT_SHIFT: u32 = 50;

/// Compute the descriptors of an image.
pub fn describe_pixels(
    grey: &[u8],
    size: ImageSize,
    shown: impl Fn(usize) -> PixelContent + Sync,
    threads: usize,
) -> Vec<PixelWord> {
    let image = describe_image(grey, size, threads);
    collect(size.pixel_count(), threads, |i| {
        let [across, down] = image.gradient[i].map(|levels| PixelWord::from((levels / 2) as i8 as u8));
        image.census[i]
            | across << ACROSS_SHIFT
            | down << DOWN_SHIFT
            | (shown(i) as PixelWord) << CONTENT_SHIFT
    })
}

#[inline(always)]
fn matching_cost(one: PixelWord, other: PixelWord) -> i16 {
    let bits = ((one ^ other) & CENSUS_MASK).count_ones() as i32;
    let levels = |word: PixelWord, at: u32| i32::from((word >> at) as u8 as i8);
    let half = |at: u32| (levels(one, at) - levels(other, at)).abs();
    combine_costs(bits, 2 * (half(ACROSS_SHIFT) + half(DOWN_SHIFT)))
}

/// Warped image of a partner view.
pub struct PartnerView {
    pub words: Vec<PixelWord>,
    pub size: ImageSize,
    /// Per plane (s, a, b): pixel (x, y) of the view maps to (s·x + a, s·y + b).
    pub maps: Vec<[f32; 3]>,
}

/// Cost if no partner sees the point (half of the maximum), and if a partner shows empty space there.
const UNSEEN_COST: i16 = 70;
const EMPTY_COST: i16 = 140;
/// Larger than any cost.
const NO_COST: i16 = i16::MAX;
/// Maximum number of partner costs that are averaged. Up to half of the partners may be occluded.
const MAX_AVERAGED: usize = 3;

/// Compute the cost of each pixel and plane: the mean of the better half of the partner costs, at most
/// [`MAX_AVERAGED`] of them.
pub fn compute_costs(
    view: &[PixelWord],
    partners: &[PartnerView],
    size: ImageSize,
    ranges: &HypothesisRanges,
    threads: usize,
) -> Vec<i16> {
    let mut volume = vec![0; ranges.value_count()];
    for_each_part(ranges.split_rows(&mut volume, size), threads, |(y, row)| {
        fill_costs(view, partners, size, ranges, y, row);
    });
    volume
}

by_processor! {
    fn fill_costs(
        view: &[PixelWord],
        partners: &[PartnerView],
        size: ImageSize,
        ranges: &HypothesisRanges,
        y: usize,
        row: &mut [i16],
    ) = fill_costs_scalar
}

#[inline(always)]
fn fill_costs_scalar(
    view: &[PixelWord],
    partners: &[PartnerView],
    size: ImageSize,
    ranges: &HypothesisRanges,
    y: usize,
    row: &mut [i16],
) {
    let lanes = || vec![0i16; ranges.max_count()];
    let (mut one, mut places) = (lanes(), vec![0i32; ranges.max_count()]);
    let (mut least, mut seen, mut empty) = ([lanes(), lanes(), lanes()], lanes(), lanes());
    let mut rest = row;
    for x in 0..size.width {
        let i = y * size.width + x;
        let (first, count) = (ranges.first[i] as usize, usize::from(ranges.count[i]));
        let (costs, others) = std::mem::take(&mut rest).split_at_mut(count);
        rest = others;
        for best in &mut least {
            best[..count].fill(NO_COST);
        }
        seen[..count].fill(0);
        empty[..count].fill(0);
        let (one, places) = (&mut one[..count], &mut places[..count]);
        for partner in partners {
            project_to_partner(&partner.maps[first..first + count], partner.size, x, y, places);
            for ((cost, &place), empty) in one.iter_mut().zip(&*places).zip(&mut empty[..count]) {
                // Pixels outside the image have a negative index.
                let word = if place < 0 { 0 } else { partner.words[place as usize] };
                *cost = if word >> CONTENT_SHIFT == PixelContent::Scene as PixelWord {
                    matching_cost(view[i], word)
                } else {
                    NO_COST
                };
                *empty |= i16::from(word >> CONTENT_SHIFT == PixelContent::Background as PixelWord);
            }
            let [a, b, c] = &mut least;
            let (a, b, c) = (&mut a[..count], &mut b[..count], &mut c[..count]);
            for (d, seen) in seen[..count].iter_mut().enumerate() {
                let cost = one[d];
                *seen += i16::from(cost != NO_COST);
                let (next, over) = (cost.min(a[d]), cost.max(a[d]));
                a[d] = next;
                let (next, over) = (over.min(b[d]), over.max(b[d]));
                b[d] = next;
                c[d] = over.min(c[d]);
            }
        }
        for (d, cost) in costs.iter_mut().enumerate() {
            let best = [least[0][d], least[1][d], least[2][d]];
            *cost = match (empty[d], (seen[d] + 1) / 2) {
                (1, _) => EMPTY_COST,
                (_, 0) => UNSEEN_COST,
                (_, 1) => best[0],
                (_, 2) => (best[0] + best[1]) / 2,
                _ => (best[0] + best[1] + best[2]) / MAX_AVERAGED as i16,
            };
        }
    }
}

/// Compute the pixel index in a partner image for each plane; −1 if outside.
#[inline(always)]
fn project_to_partner(maps: &[[f32; 3]], size: ImageSize, x: usize, y: usize, places: &mut [i32]) {
    let (x, y) = (x as f32, y as f32);
    let (width, height) = (size.width as f32, size.height as f32);
    for (place, &[scale, right, down]) in places.iter_mut().zip(maps) {
        let (u, v) = ((scale * x + right + 0.5).floor(), (scale * y + down + 0.5).floor());
        let inside = u >= 0.0 && v >= 0.0 && u < width && v < height;
        // SAFETY: both are integers inside the image; pixels outside were set to 0.
        let (u, v): (i32, i32) = unsafe {
            (if inside { u } else { 0.0 }.to_int_unchecked(), if inside { v } else { 0.0 }.to_int_unchecked())
        };
        *place = if inside { v * size.width as i32 + u } else { -1 };
    }
}

/// Nearest possible plane of each pixel, from the visual hull. The surface is probably just behind the hull:
/// each plane farther away costs `cost_per_plane` more, up to [`MAX_HULL_COST`].
pub struct HullBound {
    pub nearest: Vec<f32>,
    pub cost_per_plane: f32,
}

/// Below the cost differences that textured images produce.
const MAX_HULL_COST: f32 = 24.0;

/// Add the costs that follow from the visual hull.
pub fn add_hull_costs(
    costs: &mut [i16],
    size: ImageSize,
    ranges: &HypothesisRanges,
    bound: &HullBound,
    threads: usize,
) {
    for_each_part(ranges.split_rows(costs, size), threads, |(y, row)| {
        let mut rest = row;
        for i in y * size.width..(y + 1) * size.width {
            let (first, count) = (ranges.first[i], usize::from(ranges.count[i]));
            let (costs, others) = std::mem::take(&mut rest).split_at_mut(count);
            rest = others;
            let nearest = bound.nearest[i];
            for (d, cost) in costs.iter_mut().enumerate() {
                let behind = nearest - (first + d as i32) as f32;
                *cost = if behind < -1.0 {
                    EMPTY_COST
                } else {
                    *cost + (bound.cost_per_plane * behind.max(0.0)).min(MAX_HULL_COST) as i16
                };
            }
        }
    });
}

/// Plane-sweep result per pixel of the view.
#[derive(Clone, Debug)]
pub struct PlaneSweepResult {
    /// Plane index with a fraction.
    pub plane: Vec<f32>,
    /// Margin to the best sum of non-adjacent planes.
    pub margin: Vec<i16>,
}

/// Select the plane with the minimum sum at each pixel.
pub fn select_planes(sums: &[i16], size: ImageSize, ranges: &HypothesisRanges) -> PlaneSweepResult {
    let (plane, margin) = (0..size.pixel_count())
        .map(|i| {
            let sums = &sums[ranges.range_of(i)];
            let (best, margin) = best_and_margin(sums);
            ((best as i32 + ranges.first[i]) as f32 + subpixel_offset(sums, best), margin)
        })
        .unzip();
    PlaneSweepResult { plane, margin }
}
