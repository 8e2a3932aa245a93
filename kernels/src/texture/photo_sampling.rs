//! Interpolation of photo colours between pixels.
//!
//! Most of the time of texturing is spent here. Compilers do not vectorise this code, so it exists in a plain
//! and an AVX2 version. Both give identical bits, because every product and sum is rounded separately.

/// RGB image, row by row.
#[derive(Debug)]
pub struct PhotoPixels {
    pub width: usize,
    pub height: usize,
    /// RGBX pixels; the fourth byte is padding, so that a pixel is one 32-bit load.
    pub pixels: Vec<[u8; 4]>,
}

/// RGBX colour in a photo, and in the blurred photo.
pub type ColorPair = [[u8; 4]; 2];

/// Levels beyond which a channel counts as clipped.
const MIN_UNCLIPPED: f32 = 4.0;
const MAX_UNCLIPPED: f32 = 250.0;

/// Interpolate a photo at a position by Catmull-Rom cubics, which preserve details that bilinear
/// interpolation blurs. Also returns the bilinear colour of the blurred photo, and whether a channel of the
/// first colour is clipped.
#[inline]
pub fn sample_colors(photo: &PhotoPixels, blurred: &PhotoPixels, place: [f64; 2]) -> (ColorPair, bool) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports AVX2.
        return unsafe { wide::colors_at(photo, blurred, place) };
    }
    plain::colors_at(photo, blurred, place)
}

/// Return the interpolation cell of a position on a grid of `count` values, and the fraction in it.
#[inline(always)]
pub fn grid_cell(place: f64, count: usize) -> (usize, f64) {
    // A 32-bit integer, because processors convert it in one instruction.
    let i = (place.max(0.0) as i32).min(count as i32 - 2);
    (i as usize, (place - f64::from(i)).clamp(0.0, 1.0))
}

/// Compute the weights of four pixels in a row.
#[inline(always)]
fn catmull_rom(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

impl PhotoPixels {
    /// Interpolate the colour at a position bilinearly.
    #[inline]
    pub fn sample_bilinear(&self, place: [f64; 2]) -> [u8; 4] {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor supports AVX2.
            return unsafe { wide::linear(self, place) };
        }
        plain::linear(self, place)
    }

    /// Load two horizontally adjacent pixels.
    #[inline(always)]
    fn load_two(&self, row: usize, column: usize) -> [u8; 8] {
        let two = &self.pixels[row * self.width + column..][..2];
        let ([a, b, c, d], [e, f, g, h]) = (two[0], two[1]);
        [a, b, c, d, e, f, g, h]
    }

    /// Load four pixels of a row, from the one before `column` on, in pairs; the edge is replicated.
    #[inline(always)]
    fn load_four(&self, row: usize, column: usize) -> [[u8; 8]; 2] {
        if column >= 1 && column + 2 < self.width {
            return [self.load_two(row, column - 1), self.load_two(row, column + 1)];
        }
        let pixel =
            |k: usize| self.pixels[row * self.width + (column + k).saturating_sub(1).min(self.width - 1)];
        let two = |k: usize| {
            let ([a, b, c, d], [e, f, g, h]) = (pixel(k), pixel(k + 1));
            [a, b, c, d, e, f, g, h]
        };
        [two(0), two(2)]
    }

    /// Return the row index of tap k; the edge is replicated.
    #[inline(always)]
    fn clamp_row(&self, row: usize, k: usize) -> usize {
        (row + k).saturating_sub(1).min(self.height - 1)
    }
}

mod plain {
    use crate::texture::photo_sampling::{
        ColorPair, MAX_UNCLIPPED, MIN_UNCLIPPED, PhotoPixels, catmull_rom, grid_cell,
    };

    pub fn colors_at(photo: &PhotoPixels, blurred: &PhotoPixels, place: [f64; 2]) -> (ColorPair, bool) {
        let color = cubic(photo, place);
        let is_cut_off = color[..3].iter().any(|level| !(MIN_UNCLIPPED..=MAX_UNCLIPPED).contains(level));
        ([color.map(|level| (level + 0.5) as u8), linear(blurred, place)], is_cut_off)
    }

    fn cubic(photo: &PhotoPixels, [x, y]: [f64; 2]) -> [f32; 4] {
        let (i, s) = grid_cell(x, photo.width);
        let (j, t) = grid_cell(y, photo.height);
        let (along, down) = (catmull_rom(s as f32), catmull_rom(t as f32));
        let mut sum = [0.0; 8];
        for (k, weight) in down.iter().enumerate() {
            let [left, right] = photo.load_four(photo.clamp_row(j, k), i);
            for c in 0..8 {
                let side = c / 4;
                sum[c] += weight * (along[side] * f32::from(left[c]) + along[2 + side] * f32::from(right[c]));
            }
        }
        [0, 1, 2, 3].map(|k| (sum[k] + sum[k + 4]).clamp(0.0, 255.0))
    }

    pub fn linear(photo: &PhotoPixels, [x, y]: [f64; 2]) -> [u8; 4] {
        let (i, s) = grid_cell(x, photo.width);
        let (j, t) = grid_cell(y, photo.height);
        let (s, t) = (s as f32, t as f32);
        let mut sum = [0.0; 8];
        for (row, weight) in [(j, 1.0 - t), (j + 1, t)] {
            let two = photo.load_two(row, i);
            for c in 0..8 {
                sum[c] += weight * ([1.0 - s, s][c / 4] * f32::from(two[c]));
            }
        }
        [0, 1, 2, 3].map(|k| (sum[k] + sum[k + 4] + 0.5) as u8)
    }
}

#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::*;

    use crate::texture::photo_sampling::{
        ColorPair, MAX_UNCLIPPED, MIN_UNCLIPPED, PhotoPixels, catmull_rom, grid_cell,
    };

    #[target_feature(enable = "avx2")]
    pub fn colors_at(photo: &PhotoPixels, blurred: &PhotoPixels, [x, y]: [f64; 2]) -> (ColorPair, bool) {
        let (i, s) = grid_cell(x, photo.width);
        let (j, t) = grid_cell(y, photo.height);
        let (s, t) = (s as f32, t as f32);
        let (along, down) = (catmull_rom(s), catmull_rom(t));
        let (first, second) = (beside(along[0], along[1]), beside(along[2], along[3]));
        let mut sum = _mm256_setzero_ps();
        for (k, &weight) in down.iter().enumerate() {
            let [left, right] = photo.load_four(photo.clamp_row(j, k), i);
            let row = _mm256_add_ps(_mm256_mul_ps(first, levels(left)), _mm256_mul_ps(second, levels(right)));
            sum = _mm256_add_ps(sum, _mm256_mul_ps(_mm256_set1_ps(weight), row));
        }
        let color = _mm_min_ps(_mm_max_ps(folded(sum), _mm_setzero_ps()), _mm_set1_ps(255.0));
        let outside = _mm_or_ps(
            _mm_cmplt_ps(color, _mm_set1_ps(MIN_UNCLIPPED)),
            _mm_cmpgt_ps(color, _mm_set1_ps(MAX_UNCLIPPED)),
        );
        // The fourth channel is padding.
        let is_cut_off = _mm_movemask_ps(outside) & 7 != 0;
        ([whole(color), linear(blurred, [x, y])], is_cut_off)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub fn linear(photo: &PhotoPixels, [x, y]: [f64; 2]) -> [u8; 4] {
        let (i, s) = grid_cell(x, photo.width);
        let (j, t) = grid_cell(y, photo.height);
        let (s, t) = (s as f32, t as f32);
        let along = beside(1.0 - s, s);
        let mut sum = _mm256_setzero_ps();
        for (row, weight) in [(j, 1.0 - t), (j + 1, t)] {
            let row = _mm256_mul_ps(along, levels(photo.load_two(row, i)));
            sum = _mm256_add_ps(sum, _mm256_mul_ps(_mm256_set1_ps(weight), row));
        }
        whole(folded(sum))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn beside(one: f32, other: f32) -> __m256 {
        _mm256_set_m128(_mm_set1_ps(other), _mm_set1_ps(one))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn levels(two: [u8; 8]) -> __m256 {
        _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(two))))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn folded(sum: __m256) -> __m128 {
        _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum))
    }

    /// Round to the nearest integer levels.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn whole(levels: __m128) -> [u8; 4] {
        let whole = _mm_cvttps_epi32(_mm_add_ps(levels, _mm_set1_ps(0.5)));
        let words = _mm_packus_epi32(whole, whole);
        _mm_cvtsi128_si32(_mm_packus_epi16(words, words)).to_le_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_instructions_give_the_same_to_the_bit() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 8
        };
        for [width, height] in [[2, 2], [3, 2], [5, 7], [40, 30]] {
            let mut image = || {
                let pixels = (0..width * height).map(|_| [0; 4].map(|_: u8| next() as u8)).collect();
                PhotoPixels { width, height, pixels }
            };
            let (photo, blurred) = (image(), image());
            for step in 0..2000 {
                let place = [0, 1].map(|k| {
                    let size = [width, height][k] as f64;
                    f64::from(next()) / f64::from(1u32 << 24) * (size + 2.0) - 1.5
                        + f64::from(step % 2) * 1e-9
                });
                assert_eq!(sample_colors(&photo, &blurred, place), plain::colors_at(&photo, &blurred, place));
            }
        }
    }

    #[test]
    fn a_plane_of_levels_is_kept() {
        let level = |x: f64, y: f64| 20.0 + 3.0 * x + 2.0 * y;
        let pixels = (0..30 * 20).map(|i| [level(f64::from(i % 30), f64::from(i / 30)) as u8; 4]).collect();
        let photo = PhotoPixels { width: 30, height: 20, pixels };
        for place in [[1.0, 1.0], [7.3, 5.6], [27.0, 17.9]] {
            let ([color, blurred], is_cut_off) = sample_colors(&photo, &photo, place);
            let wanted = (level(place[0], place[1]) + 0.5) as u8;
            assert_eq!((color, blurred, is_cut_off), ([wanted; 4], [wanted; 4], false));
        }
    }
}
