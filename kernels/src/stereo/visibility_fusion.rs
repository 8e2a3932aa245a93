//! Visibility-based fusion of depth maps (Merrell et al., "Real-time visibility-based fusion of depth maps",
//! 2007).
//!
//! The depth maps of other views are rendered into the view. Each pixel then selects, among its own and the
//! rendered depths, the one with the largest sum of agreeing confidence minus the confidence of depths in
//! front of it.

use super::cost_volume::ImageSize;
use super::cross_view_checks::{OtherView, PixelProjection, ProjectedRow};
use crate::base::by_processor::by_processor;
use crate::base::parallel::{for_each_part, map};

/// Depths that are compared at once.
const GROUP: usize = 8;

/// Depth and confidence of a pixel; depth is 0 where missing.
pub type Measurement = (f32, u8);

/// Depth map of another view, with the projection from that view.
pub struct OtherDepthMap {
    /// Map and projection into the other view.
    pub view: OtherView<Measurement>,
    /// Projection from the other view.
    pub back: PixelProjection,
}

/// Fused depth of a pixel, and sums of the confidence of other views.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FusedPixel {
    pub depth: f32,
    /// Other views whose map has the same depth at the point.
    pub confirming: u16,
    /// Other views whose map has a larger depth at the point.
    pub contradicting: u16,
    /// Number of the confirming views, and of those within the narrow tolerance.
    pub counts: [u8; 2],
}

/// Relative tolerances of depth.
#[derive(Clone, Copy, Debug)]
pub struct Tolerances {
    /// For averaging.
    pub narrow: f32,
    /// For agreement.
    pub wide: f32,
}

/// Fuse the depth map of a view with the maps of other views.
pub fn fuse_depth_maps(
    own: &[Measurement],
    size: ImageSize,
    others: &[OtherDepthMap],
    tolerances: Tolerances,
    threads: usize,
) -> Vec<FusedPixel> {
    let rendered = map(others.len(), threads, || (), |(), other| render(&others[other], size));
    let mut fused = vec![FusedPixel::default(); size.pixel_count()];
    for_each_part(fused.chunks_mut(size.width).enumerate().collect(), threads, |(y, row)| {
        select_row(own, &rendered, y, tolerances, row);
        check_row(others, y, tolerances, row);
    });
    fused
}

by_processor! {
    fn render(other: &OtherDepthMap, size: ImageSize) -> Vec<Measurement> = render_scalar
}

/// Render a depth map into the view; the nearest depth of each pixel remains.
#[inline(always)]
fn render_scalar(other: &OtherDepthMap, size: ImageSize) -> Vec<Measurement> {
    let mut rendered = vec![(0.0, 0); size.pixel_count()];
    let mut projected = ProjectedRow::new(other.view.size.width);
    for (y, row) in other.view.map.chunks(other.view.size.width).enumerate() {
        projected.project(&other.back, size, 0.5, y, row.iter().map(|one| one.0));
        for ((&place, &depth), one) in projected.places.iter().zip(&projected.depths).zip(row) {
            if place >= 0 {
                let pixel: &mut Measurement = &mut rendered[place as usize];
                if pixel.0 == 0.0 || (depth as f32) < pixel.0 {
                    *pixel = (depth as f32, one.1);
                }
            }
        }
    }
    rendered
}

by_processor! {
    fn select_row(
        own: &[Measurement],
        rendered: &[Vec<Measurement>],
        y: usize,
        tolerances: Tolerances,
        row: &mut [FusedPixel],
    ) = select_depths
}

#[inline(always)]
fn select_depths(
    own: &[Measurement],
    rendered: &[Vec<Measurement>],
    y: usize,
    tolerances: Tolerances,
    row: &mut [FusedPixel],
) {
    let first = y * row.len();
    // Missing depths are infinite, so that they neither agree with other depths nor occlude them.
    let groups = (rendered.len() + 1).div_ceil(GROUP);
    let (mut depths, mut weights) = (vec![[f32::INFINITY; GROUP]; groups], vec![[0i32; GROUP]; groups]);
    for (x, pixel) in row.iter_mut().enumerate() {
        let all = std::iter::once(own[first + x]).chain(rendered.iter().map(|map| map[first + x]));
        let slots = depths.as_flattened_mut().iter_mut().zip(weights.as_flattened_mut());
        for ((depth, weight), one) in slots.zip(all) {
            *depth = if one.0 > 0.0 { one.0 } else { f32::INFINITY };
            *weight = one.1.into();
        }
        let mut best = i32::MIN;
        for &depth in depths.as_flattened().iter().filter(|depth| depth.is_finite()) {
            let [low, high] = [1.0 - tolerances.wide, 1.0 + tolerances.wide].map(|factor| factor * depth);
            let mut scores = [0; GROUP];
            for (others, weights) in depths.iter().zip(&weights) {
                for lane in 0..GROUP {
                    let (other, weight) = (others[lane], weights[lane]);
                    let signed = if other < low { -weight } else { weight };
                    scores[lane] += if other <= high { signed } else { 0 };
                }
            }
            let score = scores.iter().sum();
            if score > best {
                best = score;
                pixel.depth = depth;
            }
        }
        let (mut total, mut sum) = (0.0, 0.0);
        for (&depth, &weight) in depths.as_flattened().iter().zip(weights.as_flattened()) {
            if (depth - pixel.depth).abs() <= tolerances.narrow * pixel.depth {
                total += weight as f32;
                sum += weight as f32 * depth;
            }
        }
        if total > 0.0 {
            pixel.depth = sum / total;
        }
    }
}

by_processor! {
    fn check_row(others: &[OtherDepthMap], y: usize, tolerances: Tolerances, row: &mut [FusedPixel]) = check_in_others
}

/// Compare the depths of a row with the maps of the other views.
#[inline(always)]
fn check_in_others(others: &[OtherDepthMap], y: usize, tolerances: Tolerances, row: &mut [FusedPixel]) {
    let (mut projected, mut there) = (ProjectedRow::new(row.len()), vec![(0.0, 0); row.len()]);
    for OtherDepthMap { view, .. } in others {
        projected.project(&view.from_pixels, view.size, 0.0, y, row.iter().map(|pixel| pixel.depth));
        projected.look_up(&view.map, &mut there);
        for ((pixel, &(there, confidence)), &ahead) in row.iter_mut().zip(&there).zip(&projected.depths) {
            let there = f64::from(there);
            let behind = there / ahead - 1.0;
            // Missing depth, 0, is not behind.
            let agrees = there > 0.0 && behind.abs() <= tolerances.wide.into();
            pixel.confirming += if agrees { confidence.into() } else { 0 };
            pixel.counts[0] += u8::from(agrees);
            pixel.counts[1] += u8::from(agrees && behind.abs() <= tolerances.narrow.into());
            pixel.contradicting += if !agrees && there > ahead { confidence.into() } else { 0 };
        }
    }
}
