//! Sub-plane refinement of swept depth.
//!
//! Small windows of the view are compared with the partner images at three depths: as found by the sweep,
//! slightly behind and slightly in front. A parabola through the weighted sums of squared differences gives
//! the refined depth.

use super::cost_volume::ImageSize;
use crate::base::by_processor::by_processor;
use crate::base::parallel::for_each_part;

/// Half width of the windows in pixels.
const RADIUS: usize = 2;
/// Offset of the tested depths, in plane distances.
const OFFSET_STEPS: f32 = 0.5;
/// Noise variance in squared grey levels per pixel of a window. Partners with larger differences are probably
/// occluded, and get less weight.
const NOISE_VARIANCE: f32 = 30.0;
/// Minimum curvature of the parabola in squared grey levels per pixel; flatter parabolas are not significant.
const MIN_CURVATURE: f32 = 0.5;
/// Rows that are processed at once. Rows near a band border are warped twice.
const BAND_ROWS: usize = 64;

/// Image of a partner view, as the four pixels around each position.
pub struct PartnerImage {
    size: ImageSize,
    /// Maps (u, v, 1, inverse depth) to the homogeneous pixel of the partner.
    from_pixels: [[f32; 4]; 3],
    taps: Vec<[u8; 4]>,
}

impl PartnerImage {
    /// Prepare a partner image.
    pub fn new(grey: &[u8], size: ImageSize, from_pixels: [[f32; 4]; 3]) -> Self {
        let taps = (0..size.pixel_count())
            .map(|i| {
                let right = usize::from(i % size.width + 1 < size.width);
                let down = if i + size.width < grey.len() { size.width } else { 0 };
                [grey[i], grey[i + right], grey[i + down], grey[i + down + right]]
            })
            .collect();
        Self { size, from_pixels, taps }
    }
}

/// Refine inverse depth by at most half a plane distance.
///
/// `step`: distance between planes.
pub fn refine_inverse_depth(
    grey: &[u8],
    size: ImageSize,
    partners: &[PartnerImage],
    inverse: &[f32],
    step: f32,
    threads: usize,
) -> Vec<f32> {
    let mut refined = vec![0.0; inverse.len()];
    let bands = refined.chunks_mut(BAND_ROWS * size.width).enumerate().collect();
    for_each_part(bands, threads, |(band, part): (usize, &mut [f32])| {
        let first = band * BAND_ROWS;
        let margin = first.min(2 * RADIUS);
        let end = (first + part.len() / size.width + 2 * RADIUS).min(size.height);
        let rows = (first - margin) * size.width..end * size.width;
        let offset = OFFSET_STEPS * step;
        let band = Band {
            grey: &grey[rows.clone()],
            inverse: &inverse[rows],
            width: size.width,
            first: first - margin,
        };
        refine_band(&band, partners, offset, margin, part);
    });
    refined
}

/// Rows of the view with their margin.
struct Band<'a> {
    grey: &'a [u8],
    inverse: &'a [f32],
    width: usize,
    /// Index of the first row.
    first: usize,
}

by_processor! {
    fn refine_band(band: &Band<'_>, partners: &[PartnerImage], offset: f32, margin: usize, refined: &mut [f32]) = refine_band_scalar
}

#[inline(always)]
fn refine_band_scalar(
    band: &Band<'_>,
    partners: &[PartnerImage],
    offset: f32,
    margin: usize,
    refined: &mut [f32],
) {
    let (width, count) = (band.width, band.grey.len());
    let zeros = || vec![0f32; count];
    let mut own: Vec<f32> = band.grey.iter().map(|&level| level.into()).collect();
    let (mut warped, mut mean, mut rows) = (zeros(), zeros(), zeros());
    average(&own, width, &mut rows, &mut mean);
    own.iter_mut().zip(&mean).for_each(|(own, mean)| *own -= mean);
    let (mut costs, mut sums) = ([zeros(), zeros(), zeros()], [zeros(), zeros(), zeros()]);
    let mut scratch = WarpScratch { places: vec![0; width], fractions: vec![[0.0; 2]; width] };
    for partner in partners {
        for (way, cost) in costs.iter_mut().enumerate() {
            let shift = (way as f32 - 1.0) * offset;
            for (row, (warped, inverse)) in
                warped.chunks_exact_mut(width).zip(band.inverse.chunks_exact(width)).enumerate()
            {
                warp_row(partner, band.first + row, inverse, shift, &mut scratch, warped);
            }
            average(&warped, width, &mut rows, &mut mean);
            for ((warped, mean), own) in warped.iter_mut().zip(&mean).zip(&own) {
                let off = *warped - mean - own;
                *warped = off * off;
            }
            average(&warped, width, &mut rows, cost);
        }
        let [behind, here, before] = &costs;
        let [sum_behind, sum_here, sum_before] = &mut sums;
        for i in 0..count {
            let total = NOISE_VARIANCE + behind[i] + here[i] + before[i];
            // Not a number outside of the partner image.
            let is_seen = total < f32::INFINITY;
            let weight = 1.0 / total;
            sum_behind[i] += if is_seen { weight * behind[i] } else { 0.0 };
            sum_here[i] += if is_seen { weight * here[i] } else { 0.0 };
            sum_before[i] += if is_seen { weight * before[i] } else { 0.0 };
        }
    }
    let start = margin * width;
    let [behind, here, before] = &sums;
    for (i, refined) in (start..).zip(refined) {
        let curvature = behind[i] + before[i] - 2.0 * here[i];
        let fraction = (behind[i] - before[i]) / (2.0 * curvature);
        let fits = curvature > MIN_CURVATURE / NOISE_VARIANCE;
        *refined = band.inverse[i] + if fits { offset * fraction.clamp(-1.0, 1.0) } else { 0.0 };
    }
}

/// Average values in windows; border values are replicated outwards.
#[inline(always)]
fn average(values: &[f32], width: usize, rows: &mut [f32], means: &mut [f32]) {
    let last = width - 1;
    for (row, sums) in values.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        if width > 2 * RADIUS {
            let inner = row.windows(2 * RADIUS + 1);
            for (sum, around) in sums[RADIUS..].iter_mut().zip(inner) {
                *sum = around[0] + around[1] + around[2] + around[3] + around[4];
            }
        }
        let beside = |x: usize| (0..=2 * RADIUS).map(|k| row[(x + k).saturating_sub(RADIUS).min(last)]).sum();
        for x in (0..RADIUS.min(width)).chain(width.saturating_sub(RADIUS).max(RADIUS.min(width))..width) {
            sums[x] = beside(x);
        }
    }
    let count = values.len() / width;
    for (y, means) in means.chunks_exact_mut(width).enumerate() {
        let [a, b, c, d, e] = std::array::from_fn(|k| {
            let v = (y + k).saturating_sub(RADIUS).min(count - 1);
            &rows[v * width..][..width]
        });
        for x in 0..width {
            means[x] = (a[x] + b[x] + c[x] + d[x] + e[x]) / ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
        }
    }
}

/// Buffers for the warp of a row.
struct WarpScratch {
    places: Vec<i32>,
    fractions: Vec<[f32; 2]>,
}

/// Warp a row of the partner image to the view; NaN outside of the partner image.
#[inline(always)]
fn warp_row(
    partner: &PartnerImage,
    y: usize,
    inverse: &[f32],
    shift: f32,
    scratch: &mut WarpScratch,
    warped: &mut [f32],
) {
    let start = partner.from_pixels.map(|row| row[1] * y as f32 + row[2]);
    let [across, down, ahead] = partner.from_pixels;
    let (right, bottom) = ((partner.size.width - 1) as f32, (partner.size.height - 1) as f32);
    let row_length = partner.size.width as i32;
    for (x, ((place, fraction), inverse)) in
        scratch.places.iter_mut().zip(&mut scratch.fractions).zip(inverse).enumerate()
    {
        let (x, inverse) = (x as i32 as f32, inverse + shift);
        let z = ahead[0] * x + start[2] + ahead[3] * inverse;
        let u = (across[0] * x + start[0] + across[3] * inverse) / z;
        let v = (down[0] * x + start[1] + down[3] * inverse) / z;
        let inside = z > 0.0 && u >= 0.0 && v >= 0.0 && u <= right && v <= bottom;
        let (u, v) = (if inside { u } else { 0.0 }, if inside { v } else { 0.0 });
        let (left, top) = (u.floor(), v.floor());
        *fraction = [u - left, v - top];
        // SAFETY: both are integers inside the image; pixels outside were set to 0.
        let (column, row): (i32, i32) = unsafe { (left.to_int_unchecked(), top.to_int_unchecked()) };
        *place = if inside { row * row_length + column } else { -1 };
    }
    for ((warped, &place), &[u, v]) in warped.iter_mut().zip(&scratch.places).zip(&scratch.fractions) {
        *warped = if place < 0 {
            f32::NAN
        } else {
            let [a, b, c, d] = partner.taps[place as usize].map(f32::from);
            let (above, below) = (a + u * (b - a), c + u * (d - c));
            above + v * (below - above)
        };
    }
}
