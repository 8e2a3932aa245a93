//! Weighted median filter for disparities, with weights from colour similarity (Ma et al., "Constant time
//! weighted median filtering for stereo matching and beyond", 2013; here in direct form over a small window).

use super::cost_volume::{ImageSize, RgbImage};
use crate::base::parallel::for_each_part;

/// Weighted median, with measures of its reliability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedMedian {
    pub disparity: f32,
    /// Weight ratio of the known pixels within one disparity of the median.
    pub inlier_ratio: f32,
    /// Weight ratio of the window's pixels with a known disparity.
    pub known_ratio: f32,
}

/// Compute the weighted median at each pixel in `wanted`; NaN and zeros elsewhere, and where no disparity in
/// the window is known.
///
/// `disparity` is NaN where unknown, otherwise from `lowest` to `lowest + count`. A colour difference of
/// `falloff` levels in every channel has weight 1/e.
#[allow(clippy::too_many_arguments)]
pub fn compute_weighted_medians(
    image: &RgbImage,
    disparity: &[f32],
    wanted: &[bool],
    size: ImageSize,
    lowest: i32,
    count: usize,
    radius: usize,
    falloff: f32,
    threads: usize,
) -> Vec<WeightedMedian> {
    let none = WeightedMedian { disparity: f32::NAN, inlier_ratio: 0.0, known_ratio: 0.0 };
    let weights: Vec<f32> = (0..=3 * 255).map(|levels| (-(levels as f32) / (3.0 * falloff)).exp()).collect();
    let mut medians = vec![none; size.pixel_count()];
    for_each_part(
        medians.chunks_mut(size.width).enumerate().collect(),
        threads,
        |(y, row): (usize, &mut [WeightedMedian])| {
            // Per integer disparity: total weight, and weighted sum.
            let mut bins = vec![[0f32; 2]; count + 1];
            for (x, median) in row.iter_mut().enumerate() {
                let i = y * size.width + x;
                if !wanted[i] {
                    continue;
                }
                bins.fill([0.0; 2]);
                let (mut all, mut known) = (0f32, 0f32);
                for v in y.saturating_sub(radius)..(y + radius + 1).min(size.height) {
                    for u in x.saturating_sub(radius)..(x + radius + 1).min(size.width) {
                        let j = v * size.width + u;
                        let unlike: usize = (0..3).map(|c| image[i][c].abs_diff(image[j][c]) as usize).sum();
                        let (weight, value) = (weights[unlike], disparity[j]);
                        all += weight;
                        if !value.is_nan() {
                            let bin = (value - lowest as f32 + 0.5).clamp(0.0, count as f32) as usize;
                            bins[bin][0] += weight;
                            bins[bin][1] += weight * value;
                            known += weight;
                        }
                    }
                }
                if known > 0.0 {
                    *median = median_of_bins(&bins, all, known);
                }
            }
        },
    );
    medians
}

fn median_of_bins(bins: &[[f32; 2]], all: f32, known: f32) -> WeightedMedian {
    let mut below = 0.0;
    let mut at = 0;
    while at + 1 < bins.len() && below + bins[at][0] < known / 2.0 {
        below += bins[at][0];
        at += 1;
    }
    let near = &bins[at.saturating_sub(1)..(at + 2).min(bins.len())];
    let [weight, sum] = near.iter().fold([0.0; 2], |total, bin| [total[0] + bin[0], total[1] + bin[1]]);
    WeightedMedian { disparity: sum / weight, inlier_ratio: weight / known, known_ratio: known / all }
}
