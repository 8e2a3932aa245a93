//! Visibility-based fusion of depth maps (Merrell et al., "Real-time visibility-based fusion of depth maps",
//! 2007).
//!
//! The depth maps of other views are rendered into the view. Each pixel then selects, among its own and the
//! rendered depths, the one with the largest sum of agreeing confidence minus the confidence of depths in
//! front of it.

use super::cost_volume::ImageSize;
use super::cross_view_checks::{OtherView, PixelProjection};
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
        for (x, pixel) in row.iter_mut().enumerate() {
            check_in_others(others, x, y, tolerances, pixel);
        }
    });
    fused
}

/// Render a depth map into the view; the nearest depth of each pixel remains.
fn render(other: &OtherDepthMap, size: ImageSize) -> Vec<Measurement> {
    let mut rendered = vec![(0.0, 0); size.pixel_count()];
    let (width, height) = (size.width as f64, size.height as f64);
    for (v, row) in other.view.map.chunks(other.view.size.width).enumerate() {
        for (u, &(z, confidence)) in row.iter().enumerate() {
            if z > 0.0 {
                let [x, y, depth] = project(&other.back, u, v, z.into());
                let scale = 1.0 / depth;
                let (x, y) = (x * scale + 0.5, y * scale + 0.5);
                if depth > 0.0 && x >= 0.0 && y >= 0.0 && x < width && y < height {
                    let pixel: &mut Measurement = &mut rendered[y as usize * size.width + x as usize];
                    if pixel.0 == 0.0 || (depth as f32) < pixel.0 {
                        *pixel = (depth as f32, confidence);
                    }
                }
            }
        }
    }
    rendered
}

#[inline(always)]
fn project(matrix: &PixelProjection, u: usize, v: usize, z: f64) -> [f64; 3] {
    let (x, y) = (u as f64, v as f64);
    matrix.map(|row| (row[0] * x + row[1] * y + row[2]) * z + row[3])
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

/// Compare the depth of a pixel with the maps of the other views.
fn check_in_others(
    others: &[OtherDepthMap],
    x: usize,
    y: usize,
    tolerances: Tolerances,
    pixel: &mut FusedPixel,
) {
    if pixel.depth == 0.0 {
        return;
    }
    for other in others {
        if let Some(((there, confidence), ahead)) = other.view.look_up(x, y, pixel.depth.into()) {
            let behind = f64::from(there) / ahead - 1.0;
            if there > 0.0 && behind.abs() <= tolerances.wide.into() {
                pixel.confirming += u16::from(confidence);
                pixel.counts[0] += 1;
                pixel.counts[1] += u8::from(behind.abs() <= tolerances.narrow.into());
            } else if behind > 0.0 {
                pixel.contradicting += u16::from(confidence);
            }
        }
    }
}
