//! One colour of many photos: where they agree their mean, with the details of those that show them best.
//!
//! The colour is taken apart, as in a pyramid of two levels (Burt and Adelson 1983, "A multiresolution spline with
//! application to image mosaics"): what is blurred is a mean of many photos, so that no border of one can be seen; what is
//! left, the details, is a mean in which the best photo counts most, so that small misplacements do not blur it. Both
//! weights change smoothly over the surface.

use super::surface_points::{Sample, SurfacePoints};
use crate::base::errors::KernelError;
use crate::base::parallel::each;
use crate::base::progress::Progress;

/// The deviation of a normal distribution over its median absolute deviation.
const OF_MEDIAN: f32 = 1.4826;
const PART: usize = 1 << 14;

/// How photos are weighed.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    /// Powers of the score: for what is blurred, and for the details.
    pub blurred: i32,
    pub details: i32,
    /// Photos that differ from the median by more than so many deviations, and so many levels, do not count.
    pub deviations: f32,
    pub levels: f32,
}

/// Colours of points, and what is known of them.
#[derive(Debug)]
pub struct Blended {
    pub colors: Vec<[f32; 3]>,
    /// The best photo of those that agree, [`NO_VIEW`] for none.
    pub labels: Vec<u16>,
    /// How many photos count.
    pub views: Vec<u8>,
}

pub const NO_VIEW: u16 = u16::MAX;

/// Blend the samples of all points.
///
/// # Errors
/// As [`Progress::check`].
pub fn blend(
    points: &SurfacePoints,
    weights: &Weights,
    threads: usize,
    progress: &Progress,
) -> Result<Blended, KernelError> {
    let count = points.len();
    let mut blended =
        Blended { colors: vec![[0.0; 3]; count], labels: vec![NO_VIEW; count], views: vec![0; count] };
    let parts: Vec<_> = blended
        .colors
        .chunks_mut(PART)
        .zip(blended.labels.chunks_mut(PART))
        .zip(blended.views.chunks_mut(PART))
        .enumerate()
        .collect();
    each(parts, threads, |(number, ((colors, labels), views))| {
        for i in 0..colors.len() {
            if let Some((color, label, used)) = weights.of(points.samples(number * PART + i)) {
                (colors[i], labels[i], views[i]) = (color, label, used);
            }
        }
    });
    progress.check()?;
    Ok(blended)
}

/// More samples of a point than this are never kept.
const MOST: usize = 16;

impl Weights {
    /// The colour of samples, the best of them first; the best photo, and how many count.
    fn of(&self, samples: &[Sample]) -> Option<([f32; 3], u16, u8)> {
        let count = samples
            .iter()
            .take(MOST)
            .position(|sample| sample.score <= 0.0)
            .unwrap_or(samples.len().min(MOST));
        let samples = &samples[..count];
        let best = samples.first()?.score;
        let agreeing = self.agreeing(samples);
        let (mut base, mut base_weight) = ([0.0; 3], 0.0);
        let (mut details, mut details_weight) = ([0.0; 3], 0.0);
        let (mut label, mut used) = (NO_VIEW, 0);
        for (sample, agreeing) in samples.iter().zip(agreeing) {
            if agreeing <= 0.0 {
                continue;
            }
            used += 1;
            let share = sample.score / best;
            let (low, high) = (agreeing * share.powi(self.blurred), agreeing * share.powi(self.details));
            for k in 0..3 {
                let blurred = f32::from(sample.blurred[k]);
                base[k] += low * blurred;
                details[k] += high * (f32::from(sample.color[k]) - blurred);
            }
            base_weight += low;
            details_weight += high;
            // The best are first.
            if label == NO_VIEW {
                label = sample.view;
            }
        }
        let color =
            [0, 1, 2].map(|k| (base[k] / base_weight + details[k] / details_weight).clamp(0.0, 255.0));
        Some((color, label, used))
    }

    /// How far each sample agrees with the others, 0 to 1; falls to 0 smoothly, so that no border is seen. Of two or fewer all
    /// agree.
    fn agreeing(&self, samples: &[Sample]) -> [f32; MOST] {
        let mut agreeing = [1.0; MOST];
        let count = samples.len();
        if count < 3 {
            return agreeing;
        }
        let middle = [0, 1, 2].map(|k| {
            let mut levels = [0.0; MOST];
            for (level, sample) in levels.iter_mut().zip(samples) {
                *level = f32::from(sample.blurred[k]);
            }
            median(&mut levels[..count])
        });
        let mut apart = [0.0f32; MOST];
        for (apart, sample) in apart.iter_mut().zip(samples) {
            *apart = (0..3).map(|k| (f32::from(sample.blurred[k]) - middle[k]).abs()).fold(0.0, f32::max);
        }
        let mut sorted = apart;
        let limit = (self.deviations * OF_MEDIAN * median(&mut sorted[..count])).max(self.levels);
        for (agreeing, apart) in agreeing.iter_mut().zip(&apart[..count]) {
            let rest = (1.0 - (apart / limit).powi(2)).max(0.0);
            *agreeing = rest * rest;
        }
        agreeing
    }
}

/// The median of a few values, the mean of the middle two if there are; they are sorted.
fn median(values: &mut [f32]) -> f32 {
    for i in 1..values.len() {
        let mut j = i;
        while j > 0 && values[j - 1] > values[j] {
            values.swap(j - 1, j);
            j -= 1;
        }
    }
    let half = values.len() / 2;
    if values.len() % 2 == 1 { values[half] } else { 0.5 * (values[half - 1] + values[half]) }
}
