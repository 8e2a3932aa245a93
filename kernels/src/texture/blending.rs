//! Blending of many photos into one colour per point: the mean of consistent photos, with the details of the
//! best ones.
//!
//! The colour is split into two frequency bands (Burt and Adelson 1983, "A multiresolution spline with
//! application to image mosaics"). The low frequencies are a mean of many photos, so that photo borders are
//! invisible. The high frequencies are a mean dominated by the best photo, so that small misalignments do not
//! blur details. Both weights vary smoothly over the surface.

use super::surface_points::{MAX_SAMPLES as MOST, PointSamples, SurfacePoints};
use crate::base::errors::KernelError;
use crate::base::parallel::for_each_part;
use crate::base::progress::Progress;

/// Standard deviation of a normal distribution divided by its median absolute deviation.
const DEVIATION_PER_MAD: f32 = 1.4826;
const POINTS_PER_PART: usize = 1 << 14;

/// Weights of the photos.
#[derive(Clone, Copy, Debug)]
pub struct BlendWeights {
    /// Exponents of the score, for low frequencies and for details.
    pub low_exponent: i32,
    pub detail_exponent: i32,
    /// Photos that differ from the median by more than this number of standard deviations, and by more than
    /// this number of levels, are rejected as outliers.
    pub max_deviations: f32,
    pub min_levels: f32,
}

/// Blended colours, with their source photos.
#[derive(Debug)]
pub struct BlendedColors {
    pub colors: Vec<[f32; 3]>,
    /// Best inlier photo of each point; [`NO_VIEW`] if there is no photo.
    pub labels: Vec<u16>,
    /// Number of inlier photos.
    pub views: Vec<u8>,
}

/// Marker for a point without photos.
pub const NO_VIEW: u16 = u16::MAX;

/// Blend the samples of all points.
pub fn blend_points(
    points: &SurfacePoints,
    weights: &BlendWeights,
    threads: usize,
    progress: &Progress,
) -> Result<BlendedColors, KernelError> {
    let count = points.len();
    let mut blended =
        BlendedColors { colors: vec![[0.0; 3]; count], labels: vec![NO_VIEW; count], views: vec![0; count] };
    let parts: Vec<_> = blended
        .colors
        .chunks_mut(POINTS_PER_PART)
        .zip(blended.labels.chunks_mut(POINTS_PER_PART))
        .zip(blended.views.chunks_mut(POINTS_PER_PART))
        .enumerate()
        .collect();
    for_each_part(parts, threads, |(number, ((colors, labels), views))| {
        for start in (0..colors.len()).step_by(POINTS_PER_BATCH) {
            let count = POINTS_PER_BATCH.min(colors.len() - start);
            let mut samples = [PointSamples::default(); POINTS_PER_BATCH];
            for (i, samples) in samples[..count].iter_mut().enumerate() {
                *samples = points.samples(number * POINTS_PER_PART + start + i);
            }
            let agreeing = weights.inlier_weights(&samples);
            for (i, samples) in samples[..count].iter().enumerate() {
                if let Some((color, label, used)) = weights.blend_samples(samples, &agreeing[i]) {
                    (colors[start + i], labels[start + i], views[start + i]) = (color, label, used);
                }
            }
        }
    });
    progress.check()?;
    Ok(blended)
}

/// Points processed together by one sorting network.
const POINTS_PER_BATCH: usize = 8;
/// One value per point.
type BatchValues = [i16; POINTS_PER_BATCH];

impl BlendWeights {
    /// Blend samples with the given inlier weights. Returns the colour, the best inlier photo, and the number
    /// of inliers.
    fn blend_samples(
        &self,
        samples: &PointSamples<'_>,
        agreeing: &[f32; MOST],
    ) -> Option<([f32; 3], u16, u8)> {
        let best = samples.scores.iter().copied().reduce(f32::max)?;
        let (mut base, mut base_weight) = ([0.0; 3], 0.0);
        let (mut details, mut details_weight) = ([0.0; 3], 0.0);
        let (mut first, mut used) = (None, 0);
        for (i, &agreeing) in agreeing[..samples.len()].iter().enumerate() {
            if agreeing <= 0.0 {
                continue;
            }
            used += 1;
            let share = samples.scores[i] / best;
            let (low, high) =
                (agreeing * share.powi(self.low_exponent), agreeing * share.powi(self.detail_exponent));
            let [color, blurred] = samples.colors[i];
            for k in 0..3 {
                let blurred = f32::from(blurred[k]);
                base[k] += low * blurred;
                details[k] += high * (f32::from(color[k]) - blurred);
            }
            base_weight += low;
            details_weight += high;
            if first.is_none_or(|first| samples.is_better(i, first)) {
                first = Some(i);
            }
        }
        let label = first.map_or(NO_VIEW, |first| samples.views[first]);
        let color =
            [0, 1, 2].map(|k| (base[k] / base_weight + details[k] / details_weight).clamp(0.0, 255.0));
        Some((color, label, used))
    }

    /// Compute the inlier weight of each sample, 0 to 1. It falls to 0 smoothly, so that no border is
    /// visible. With two or fewer samples, all weights are 1.
    fn inlier_weights(
        &self,
        points: &[PointSamples<'_>; POINTS_PER_BATCH],
    ) -> [[f32; MOST]; POINTS_PER_BATCH] {
        let counts = points.each_ref().map(PointSamples::len);
        let mut levels = [[[i16::MAX; POINTS_PER_BATCH]; MOST]; 3];
        for (i, samples) in points.iter().enumerate() {
            for (k, [_, blurred]) in samples.colors.iter().enumerate() {
                for (channel, levels) in levels.iter_mut().enumerate() {
                    levels[k][i] = blurred[channel].into();
                }
            }
        }
        // Doubled medians, which are integers.
        let middle = levels.map(|levels| doubled_medians(levels, &counts));
        let mut apart = [[i16::MAX; POINTS_PER_BATCH]; MOST];
        for (i, samples) in points.iter().enumerate() {
            for (apart, [_, blurred]) in apart.iter_mut().zip(samples.colors) {
                let off = |channel: usize| 2 * i16::from(blurred[channel]) - middle[channel][i];
                apart[i] = off(0).abs().max(off(1).abs()).max(off(2).abs());
            }
        }
        let medians = doubled_medians(apart, &counts);
        let mut agreeing = [[1.0; MOST]; POINTS_PER_BATCH];
        for i in (0..POINTS_PER_BATCH).filter(|&i| counts[i] > 2) {
            let median = 0.25 * f32::from(medians[i]);
            let limit = (self.max_deviations * DEVIATION_PER_MAD * median).max(self.min_levels);
            for (agreeing, apart) in agreeing[i].iter_mut().zip(&apart[..counts[i]]) {
                let rest = (1.0 - (0.5 * f32::from(apart[i]) / limit).powi(2)).max(0.0);
                *agreeing = rest * rest;
            }
        }
        agreeing
    }
}

/// Compute twice the median of each column's first `counts` rows; for an even count, the mean of the middle
/// two is doubled. The remaining rows must hold the maximum value.
fn doubled_medians(mut rows: [BatchValues; MOST], counts: &[usize; POINTS_PER_BATCH]) -> BatchValues {
    let are_few = counts.iter().all(|&count| count <= MOST / 2);
    for &[i, j] in if are_few { &HALF_COMPARATORS[..] } else { &ALL_COMPARATORS } {
        let (a, b) = (rows[usize::from(i)], rows[usize::from(j)]);
        for k in 0..POINTS_PER_BATCH {
            rows[usize::from(i)][k] = a[k].min(b[k]);
            rows[usize::from(j)][k] = a[k].max(b[k]);
        }
    }
    std::array::from_fn(|k| {
        let count = counts[k].max(1);
        // A column without samples gives an arbitrary value, which is not used.
        rows[(count - 1) / 2][k].wrapping_add(rows[count / 2][k])
    })
}

/// Comparators of the sorting networks: data-independent, so that all columns are sorted at once.
const ALL_COMPARATORS: [[u8; 2]; 63] = sorting_network(MOST);
const HALF_COMPARATORS: [[u8; 2]; 19] = sorting_network(MOST / 2);

/// List the comparators of Batcher's odd-even merge sort for `size` values, a power of two.
const fn sorting_network<const COUNT: usize>(size: usize) -> [[u8; 2]; COUNT] {
    let mut pairs = [[0; 2]; COUNT];
    let mut count = 0;
    let mut run = 1;
    while run < size {
        let mut step = run;
        while step >= 1 {
            let mut i = step % run;
            while i + step < size {
                let is_first = (i - step % run) / step % 2 == 0;
                if is_first && i / (2 * run) == (i + step) / (2 * run) {
                    pairs[count] = [i as u8, (i + step) as u8];
                    count += 1;
                }
                i += 1;
            }
            step /= 2;
        }
        run *= 2;
    }
    assert!(count == COUNT);
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_those_of_sorted_values() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as i16
        };
        for most in (1..=MOST).cycle().take(500) {
            let counts = [(); POINTS_PER_BATCH].map(|()| 1 + next() as usize % most);
            let mut rows = [[i16::MAX; POINTS_PER_BATCH]; MOST];
            for (k, &count) in counts.iter().enumerate() {
                rows[..count].iter_mut().for_each(|row| row[k] = next());
            }
            let found = doubled_medians(rows, &counts);
            for (k, &count) in counts.iter().enumerate() {
                let mut column: Vec<i16> = rows[..count].iter().map(|row| row[k]).collect();
                column.sort_unstable();
                assert_eq!(found[k], column[(count - 1) / 2] + column[count / 2]);
            }
        }
    }
}
