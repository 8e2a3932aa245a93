//! Surface orientation and discontinuities of a depth map.
//!
//! Gradients are computed on inverse depth. The inverse depth of a plane is linear in the pixel coordinates,
//! so gradients averaged over a window are exact on planes at any viewing angle. Gradients of depth itself
//! are not.

use super::frame_view::FusionCamera;
use crate::base::by_processor::by_processor;
use crate::base::parallel::for_each_part;

/// Window side in pixels for averaged gradients: large enough to smooth the depth steps of a structured-light
/// sensor, small enough to preserve the edge of a table.
const NARROW_WINDOW: usize = 5;
/// Obliqueness above which a pixel is checked for planarity: 2.9 is about 70°. It is accepted only on a
/// plane, such as a road: the gradient averaged over a `WIDE_WINDOW` window must agree up to the factor `MAX_SLOPE_RATIO`.
/// Otherwise the pixel belongs to the outline of a round or ragged object, where the distance along the
/// normal is uncertain, and its obliqueness is capped at `MAX_OBLIQUENESS`. Above `MAX_UNCONFIRMED_OBLIQUENESS` it is dropped, as part of a
/// discontinuity that the sensor or the matcher has smeared.
const MAX_OBLIQUENESS: f32 = 2.9;
const MAX_UNCONFIRMED_OBLIQUENESS: f32 = 5.0;
const WIDE_WINDOW: usize = 25;
const MAX_SLOPE_RATIO: f32 = 1.5;
/// Rows processed together. Running sums restart in each band, so that results do not depend on the thread
/// count.
const BAND_ROWS: usize = 48;

/// Limits for usable depth.
#[derive(Clone, Copy, Debug)]
pub struct DepthLimits {
    /// Depth range in metres.
    pub min_depth: f32,
    pub max_depth: f32,
    /// Relative change of depth between neighbouring pixels that counts as a discontinuity.
    pub jump: f32,
    /// Cosine of the maximum angle between the line of sight and the surface normal.
    pub min_cosine: f32,
}

/// Depth map with surface normals, row by row.
#[derive(Clone, Debug)]
pub struct OrientedDepth {
    /// Depth in metres, 0 where missing or dropped.
    pub depth: Vec<f32>,
    /// Surface normal in camera axes, facing the camera, scaled so that its dot product with the pixel ray
    /// (x/z, y/z, 1) is −1.
    pub normal: [Vec<f32>; 3],
    /// Length of `scaled_normal`: metres along the optical axis per metre of distance from the surface.
    pub obliqueness: Vec<f32>,
}

/// Estimate surface normals, and drop pixels at depth discontinuities or at grazing angles.
///
/// Sensors and matchers produce "flying" pixels at a discontinuity, between the near and the far surface.
/// Pixels on both sides of a discontinuity are therefore dropped. Gaps of one pixel between consistent depths
/// are filled, because depth warped into the view of a colour camera has many of them.
pub fn filter_depth_map(
    mut depth: Vec<f32>,
    camera: &FusionCamera,
    limits: DepthLimits,
    threads: usize,
) -> OrientedDepth {
    let (width, height) = (camera.width, camera.height);
    let inverse = fill_single_gaps(&mut depth, width, limits);
    let differences = inverse_depth_differences(&inverse, width, limits.jump);
    let mut normal = [0, 1, 2].map(|_| vec![0.0; depth.len()]);
    let mut obliqueness = vec![0.0; depth.len()];
    let across: Vec<f32> =
        (0..width).map(|x| ((x as f64 - camera.centre[0]) / camera.focal[0]) as f32).collect();
    let down: Vec<f32> =
        (0..height).map(|y| ((y as f64 - camera.centre[1]) / camera.focal[1]) as f32).collect();
    let sights = PixelRays { across, down, focal: camera.focal.map(|f| f as f32) };
    let [x, y, z] = &mut normal;
    let bands = depth
        .chunks_mut(BAND_ROWS * width)
        .zip(x.chunks_mut(BAND_ROWS * width))
        .zip(y.chunks_mut(BAND_ROWS * width))
        .zip(z.chunks_mut(BAND_ROWS * width))
        .zip(obliqueness.chunks_mut(BAND_ROWS * width))
        .enumerate()
        .map(|(number, ((((depth, x), y), z), obliqueness))| FilterBand {
            top: number * BAND_ROWS,
            depth,
            normal: [x, y, z],
            obliqueness,
        })
        .collect();
    for_each_part(bands, threads, |mut band: FilterBand<'_>| {
        band.estimate_normals(&differences, &sights);
        let dropped = band.check_steep_pixels(&differences, &sights);
        band.drop_unreliable(&differences, &sights, limits.min_cosine, &dropped);
    });
    OrientedDepth { depth, normal, obliqueness }
}

/// Fill gaps of one pixel, first along rows, and remove depth outside the limits. Returns the inverse depth,
/// 0 where missing.
fn fill_single_gaps(depth: &mut [f32], width: usize, limits: DepthLimits) -> Vec<f32> {
    let mut inverse = vec![0.0; depth.len()];
    for (depth, inverse) in depth.chunks_mut(width).zip(inverse.chunks_mut(width)) {
        invert(depth, inverse, limits);
        // A filled pixel has measured pixels on both sides, so no gap is filled from another filled pixel.
        for x in 1..width.max(1) - 1 {
            if inverse[x] == 0.0 {
                let beside = [inverse[x - 1], inverse[x + 1]];
                fill_gap(&mut depth[x], &mut inverse[x], beside, limits.jump);
            }
        }
    }
    for y in 1..(depth.len() / width).max(1) - 1 {
        let (above, rest) = inverse.split_at_mut(y * width);
        let (own, below) = rest.split_at_mut(width);
        let above = &above[(y - 1) * width..];
        for x in 0..width {
            if own[x] == 0.0 {
                fill_gap(&mut depth[y * width + x], &mut own[x], [above[x], below[x]], limits.jump);
            }
        }
    }
    inverse
}

fn fill_gap(depth: &mut f32, inverse: &mut f32, [a, b]: [f32; 2], jump: f32) {
    let least = a.min(b);
    if least > 0.0 && (a - b).abs() <= jump * least {
        *inverse = (a + b) / 2.0;
        *depth = 1.0 / *inverse;
    }
}

by_processor! {
    fn invert(depth: &mut [f32], inverse: &mut [f32], limits: DepthLimits) = invert_depth_row
}

#[inline(always)]
fn invert_depth_row(depth: &mut [f32], inverse: &mut [f32], limits: DepthLimits) {
    for (depth, inverse) in depth.iter_mut().zip(inverse) {
        let found = 1.0 / *depth;
        // An infinite inverse would make all differences in its window NaN.
        let is_there = (*depth > 0.0)
            & (*depth >= limits.min_depth)
            & (*depth <= limits.max_depth)
            & (found < f32::INFINITY);
        *depth = if is_there { *depth } else { 0.0 };
        *inverse = if is_there { found } else { 0.0 };
    }
}

/// Differences of inverse depth to the next pixel along rows and columns, and flags for valid ones. Missing
/// differences and discontinuities have value 0 and flag 0.
struct InverseDepthDifferences {
    width: usize,
    across: Vec<f32>,
    down: Vec<f32>,
    known_across: Vec<u8>,
    known_down: Vec<u8>,
    /// Flag of pixels next to a discontinuity.
    near_discontinuity: Vec<u8>,
}

fn inverse_depth_differences(inverse: &[f32], width: usize, jump: f32) -> InverseDepthDifferences {
    let count = inverse.len();
    let [mut across, mut down] = [0, 1].map(|_| vec![0.0; count]);
    let [mut known_across, mut known_down, mut torn] = [0, 1, 2].map(|_| vec![0; count]);
    let mut jumps = vec![0; width];
    for start in (0..count).step_by(width) {
        let own = start..start + width;
        let row = &inverse[own.clone()];
        let last = start + width - 1;
        step(
            &row[..width - 1],
            &row[1..],
            jump,
            &mut across[start..last],
            &mut known_across[start..last],
            &mut jumps,
        );
        for (torn, jump) in torn[start..last].iter_mut().zip(&jumps) {
            *torn |= jump;
        }
        for (torn, jump) in torn[start + 1..=last].iter_mut().zip(&jumps) {
            *torn |= jump;
        }
        if own.end < count {
            let next = own.end..own.end + width;
            step(
                row,
                &inverse[next.clone()],
                jump,
                &mut down[own.clone()],
                &mut known_down[own.clone()],
                &mut jumps,
            );
            for rows in [own, next] {
                for (torn, jump) in torn[rows].iter_mut().zip(&jumps) {
                    *torn |= jump;
                }
            }
        }
    }
    InverseDepthDifferences { width, across, down, known_across, known_down, near_discontinuity: torn }
}

by_processor! {
    fn step(one: &[f32], next: &[f32], jump: f32, value: &mut [f32], known: &mut [u8], jumps: &mut [u8]) = difference_row
}

#[inline(always)]
fn difference_row(
    one: &[f32],
    next: &[f32],
    jump: f32,
    value: &mut [f32],
    known: &mut [u8],
    jumps: &mut [u8],
) {
    let count = one.len();
    let (next, value) = (&next[..count], &mut value[..count]);
    let (known, jumps) = (&mut known[..count], &mut jumps[..count]);
    for i in 0..count {
        let (a, b) = (one[i], next[i]);
        let difference = b - a;
        let least = if a < b { a } else { b };
        let (is_there, is_jump) = (least > 0.0, difference.abs() > jump * least);
        value[i] = if is_there & !is_jump { difference } else { 0.0 };
        known[i] = u8::from(is_there & !is_jump);
        jumps[i] = u8::from(is_there & is_jump);
    }
}

/// Pixel rays (x/z, y/z, 1): x/z of each column, y/z of each row; and the focal lengths in pixels.
struct PixelRays {
    across: Vec<f32>,
    down: Vec<f32>,
    focal: [f32; 2],
}

/// Some rows of the result.
struct FilterBand<'a> {
    top: usize,
    depth: &'a mut [f32],
    normal: [&'a mut [f32]; 3],
    obliqueness: &'a mut [f32],
}

impl FilterBand<'_> {
    /// Estimate normals from gradients averaged over the narrow window.
    fn estimate_normals(&mut self, differences: &InverseDepthDifferences, sights: &PixelRays) {
        let width = differences.width;
        let reach = NARROW_WINDOW / 2;
        // Padded by the part of the window that extends beyond the image.
        let mut sums = WindowSums {
            value: [0, 1].map(|_| vec![0.0; width + 2 * reach]),
            known: [0, 1].map(|_| vec![0; width + 2 * reach]),
        };
        for (row, depth) in self.depth.chunks(width).enumerate() {
            let y = self.top + row;
            sums.add_up(differences, y.saturating_sub(reach)..(y + reach + 1).min(sights.down.len()));
            let own = row * width..(row + 1) * width;
            let [x_row, y_row, z_row] = &mut self.normal;
            let normal = [&mut x_row[own.clone()], &mut y_row[own.clone()], &mut z_row[own.clone()]];
            orient(depth, &sums, sights, sights.down[y], normal, &mut self.obliqueness[own]);
        }
    }

    /// Check steep pixels for planarity with the wide window. Where the surface is not planar, reduce the
    /// obliqueness to `MAX_OBLIQUENESS`. Returns the indices in the band of pixels to drop.
    fn check_steep_pixels(
        &mut self,
        differences: &InverseDepthDifferences,
        sights: &PixelRays,
    ) -> Vec<usize> {
        let (width, reach) = (differences.width, WIDE_WINDOW / 2);
        let height = sights.down.len();
        let is_steep = |row: &[f32]| row.iter().fold(false, |any, &o| any | (o > MAX_OBLIQUENESS));
        let mut steep = self.obliqueness.chunks(width).enumerate().filter(|(_, row)| is_steep(row));
        let Some((first, _)) = steep.next() else { return vec![] };
        let last = steep.next_back().map_or(first, |(row, _)| row);
        let mut columns = ColumnSums::new(width);
        let mut reached = (self.top + first).saturating_sub(reach)..(self.top + first).saturating_sub(reach);
        let mut dropped = vec![];
        for row in first..=last {
            let y = self.top + row;
            let window = y.saturating_sub(reach)..(y + reach + 1).min(height);
            (reached.end..window.end).for_each(|y| columns.add_row(differences, y, 1));
            (reached.start..window.start).for_each(|y| columns.add_row(differences, y, -1));
            reached = window;
            for x in 0..width {
                let i = row * width + x;
                let narrow = self.obliqueness[i];
                if narrow.is_nan() || narrow <= MAX_OBLIQUENESS {
                    continue;
                }
                let slope = columns.mean(x.saturating_sub(reach)..(x + reach + 1).min(width));
                let normal =
                    scaled_normal(self.depth[i], slope, sights.across[x], sights.down[y], sights.focal);
                let wide = length(normal);
                if wide >= MAX_SLOPE_RATIO * narrow || wide * MAX_SLOPE_RATIO <= narrow {
                    if narrow > MAX_UNCONFIRMED_OBLIQUENESS {
                        dropped.push(i);
                    }
                    let share = MAX_OBLIQUENESS / narrow;
                    self.normal.iter_mut().for_each(|axis| axis[i] *= share);
                    self.obliqueness[i] *= share;
                }
            }
        }
        dropped
    }

    fn drop_unreliable(
        &mut self,
        differences: &InverseDepthDifferences,
        sights: &PixelRays,
        cosine: f32,
        dropped: &[usize],
    ) {
        let width = differences.width;
        for &i in dropped {
            self.depth[i] = 0.0;
        }
        for (row, depth) in self.depth.chunks_mut(width).enumerate() {
            let y = self.top + row;
            let oblique = &self.obliqueness[row * width..(row + 1) * width];
            drop_row(
                depth,
                oblique,
                &differences.near_discontinuity[y * width..],
                &sights.across,
                sights.down[y],
                cosine,
            );
        }
    }
}

/// Sums over the rows of the narrow window, per column.
struct WindowSums {
    value: [Vec<f32>; 2],
    known: [Vec<u8>; 2],
}

impl WindowSums {
    fn add_up(&mut self, differences: &InverseDepthDifferences, rows: std::ops::Range<usize>) {
        let width = differences.width;
        let values = [&differences.across, &differences.down];
        let known = [&differences.known_across, &differences.known_down];
        for axis in 0..2 {
            let value_sum = &mut self.value[axis][NARROW_WINDOW / 2..][..width];
            let known_sum = &mut self.known[axis][NARROW_WINDOW / 2..][..width];
            value_sum.fill(0.0);
            known_sum.fill(0);
            for y in rows.clone() {
                let own = y * width..(y + 1) * width;
                add_row(value_sum, known_sum, &values[axis][own.clone()], &known[axis][own]);
            }
        }
    }
}

by_processor! {
    fn add_row(sum: &mut [f32], count: &mut [u8], value: &[f32], known: &[u8]) = add_values
}

#[inline(always)]
fn add_values(sum: &mut [f32], count: &mut [u8], value: &[f32], known: &[u8]) {
    sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += value);
    count.iter_mut().zip(known).for_each(|(count, known)| *count += known);
}

by_processor! {
    fn orient(depth: &[f32], sums: &WindowSums, sights: &PixelRays, down: f32, normal: [&mut [f32]; 3], obliqueness: &mut [f32]) = orient_row
}

#[inline(always)]
fn orient_row(
    depth: &[f32],
    sums: &WindowSums,
    sights: &PixelRays,
    down: f32,
    [x_row, y_row, z_row]: [&mut [f32]; 3],
    obliqueness: &mut [f32],
) {
    let width = depth.len();
    let (across, padded) = (&sights.across[..width], width + NARROW_WINDOW - 1);
    let (x_row, y_row, z_row) = (&mut x_row[..width], &mut y_row[..width], &mut z_row[..width]);
    let obliqueness = &mut obliqueness[..width];
    let value = [&sums.value[0][..padded], &sums.value[1][..padded]];
    let known = [&sums.known[0][..padded], &sums.known[1][..padded]];
    for x in 0..width {
        let slope = [window_mean(value[0], known[0], x), window_mean(value[1], known[1], x)];
        let n = scaled_normal(depth[x], slope, across[x], down, sights.focal);
        (x_row[x], y_row[x], z_row[x]) = (n[0], n[1], n[2]);
        obliqueness[x] = length(n);
    }
}

/// Average the valid differences over the columns of the narrow window.
#[inline(always)]
fn window_mean(value: &[f32], known: &[u8], x: usize) -> f32 {
    let (mut sum, mut count) = (value[x], known[x]);
    for k in 1..NARROW_WINDOW {
        sum += value[x + k];
        count += known[x + k];
    }
    sum / f32::from(if count > 0 { count } else { 1 })
}

/// Compute the scaled normal from the gradient of inverse depth, with d ln z = −z d(1/z).
#[inline(always)]
fn scaled_normal(depth: f32, slope: [f32; 2], across: f32, down: f32, focal: [f32; 2]) -> [f32; 3] {
    let (x, y) = (-focal[0] * depth * slope[0], -focal[1] * depth * slope[1]);
    [x, y, -(1.0 + across * x + down * y)]
}

#[inline(always)]
fn length([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

by_processor! {
    fn drop_row(depth: &mut [f32], oblique: &[f32], torn: &[u8], across: &[f32], down: f32, cosine: f32) = drop_pixels
}

#[inline(always)]
fn drop_pixels(depth: &mut [f32], oblique: &[f32], torn: &[u8], across: &[f32], down: f32, cosine: f32) {
    let width = depth.len();
    let (oblique, torn, across) = (&oblique[..width], &torn[..width], &across[..width]);
    for x in 0..width {
        // Cosine of the viewing angle: 1 / (obliqueness · length of the ray).
        let sight = (1.0 + across[x] * across[x] + down * down).sqrt();
        let is_dropped = (torn[x] != 0) | (oblique[x] * sight * cosine > 1.0);
        depth[x] = if is_dropped { 0.0 } else { depth[x] };
    }
}

/// Sums over the rows of the wide window, per column.
struct ColumnSums {
    value: [Vec<f64>; 2],
    known: [Vec<i32>; 2],
}

impl ColumnSums {
    fn new(width: usize) -> Self {
        Self { value: [0, 1].map(|_| vec![0.0; width]), known: [0, 1].map(|_| vec![0; width]) }
    }

    /// Add a row (`times` = 1) or remove it (−1).
    fn add_row(&mut self, differences: &InverseDepthDifferences, y: usize, times: i32) {
        let own = y * differences.width..(y + 1) * differences.width;
        let [across, down] = &mut self.value;
        change_row(across, &differences.across[own.clone()], times.into());
        change_row(down, &differences.down[own.clone()], times.into());
        let known = [&differences.known_across[own.clone()], &differences.known_down[own]];
        for (count, known) in self.known.iter_mut().zip(known) {
            count.iter_mut().zip(known).for_each(|(count, &known)| *count += times * i32::from(known));
        }
    }

    /// Average the valid differences over a range of columns.
    fn mean(&self, columns: std::ops::Range<usize>) -> [f32; 2] {
        [0, 1].map(|axis| {
            let sum: f64 = self.value[axis][columns.clone()].iter().sum();
            let count: i32 = self.known[axis][columns.clone()].iter().sum();
            (sum / f64::from(count.max(1))) as f32
        })
    }
}

by_processor! {
    fn change_row(sum: &mut [f64], value: &[f32], times: f64) = add_scaled_row
}

#[inline(always)]
fn add_scaled_row(sum: &mut [f64], value: &[f32], times: f64) {
    sum.iter_mut().zip(value).for_each(|(sum, &value)| *sum += times * f64::from(value));
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 90;
    const HEIGHT: usize = 130;

    type Step = fn(&[f32], &[f32], f32, &mut [f32], &mut [u8], &mut [u8]);
    type Orient = fn(&[f32], &WindowSums, &PixelRays, f32, [&mut [f32]; 3], &mut [f32]);

    /// Depth map of a floor at a grazing angle in front of a wall, with holes, gaps, steps and noise.
    fn depth() -> Vec<f32> {
        let at = |i: usize| {
            let (x, y) = (i % WIDTH, i / WIDTH);
            let noise = 1.0 + 0.002 * ((i * 7919 % 1000) as f32 / 1000.0 - 0.5);
            let floor = 40.0 / (y as f32 + 1.0);
            if x % 11 == 0 || (30..40).contains(&y) && x > 60 { 0.0 } else { floor.min(2.5) * noise }
        };
        (0..WIDTH * HEIGHT).map(at).collect()
    }

    fn filtered(depth: Vec<f32>, threads: usize) -> OrientedDepth {
        let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let camera = FusionCamera::new((WIDTH, HEIGHT), [80.0, 80.0], [45.0, 10.0], pose);
        let limits = DepthLimits { min_depth: 0.0, max_depth: 9.0, jump: 0.05, min_cosine: 0.05 };
        filter_depth_map(depth, &camera, limits, threads)
    }

    fn bits(found: &OrientedDepth) -> Vec<u32> {
        let images = found.normal.iter().chain([&found.depth, &found.obliqueness]);
        images.flatten().map(|value| value.to_bits()).collect()
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let one = filtered(depth(), 1);
        assert!(one.depth.iter().filter(|&&z| z > 0.0).count() > one.depth.len() / 2);
        assert!(one.obliqueness.iter().any(|&o| o > MAX_OBLIQUENESS));
        assert!([2, 5].iter().all(|&threads| bits(&filtered(depth(), threads)) == bits(&one)));
    }

    #[test]
    fn depth_without_an_inverse_is_missing_and_spoils_nothing_beside_it() {
        let with = |z: f32| {
            let mut depth = depth();
            (0..depth.len()).step_by(37).for_each(|i| depth[i] = z);
            filtered(depth, 1)
        };
        let missing = with(0.0);
        assert!(missing.obliqueness.iter().all(|o| o.is_finite()));
        for z in [1e-40, f32::INFINITY, f32::NAN, -1.0] {
            assert!(bits(&with(z)) == bits(&missing), "{z:e}");
        }
    }

    #[test]
    fn wide_instructions_give_the_bits_of_plain_ones() {
        let depth = depth();
        let limits = DepthLimits { min_depth: 0.1, max_depth: 9.0, jump: 0.05, min_cosine: 0.05 };
        let inverted = |invert: fn(&mut [f32], &mut [f32], DepthLimits)| {
            let (mut depth, mut inverse) = (depth.clone(), vec![0.0; depth.len()]);
            invert(&mut depth, &mut inverse, limits);
            inverse
        };
        let inverse = inverted(invert);
        assert_eq!(inverse, inverted(invert_depth_row));
        let stepped = |step: Step| {
            let (mut value, mut known, mut jumps) = (vec![0.0; WIDTH], vec![0; WIDTH], vec![0; WIDTH]);
            step(&inverse[..WIDTH], &inverse[WIDTH..2 * WIDTH], 0.05, &mut value, &mut known, &mut jumps);
            (value, known, jumps)
        };
        assert_eq!(stepped(step), stepped(difference_row));
        let sights = PixelRays {
            across: (0..WIDTH).map(|x| x as f32 / 80.0 - 0.5).collect(),
            down: vec![],
            focal: [80.0, 81.0],
        };
        let padded = WIDTH + NARROW_WINDOW - 1;
        let sums = WindowSums {
            value: [0, 1].map(|k| (0..padded).map(|x| ((x * 31 + k) % 17) as f32 / 99.0).collect()),
            known: [0, 1].map(|k| (0..padded).map(|x| ((x + k) % 6) as u8).collect()),
        };
        let orientated = |orient: Orient| {
            let [mut x, mut y, mut z, mut length] = [0, 1, 2, 3].map(|_| vec![0.0; WIDTH]);
            orient(&depth[..WIDTH], &sums, &sights, 0.3, [&mut x, &mut y, &mut z], &mut length);
            [x, y, z, length].concat().iter().map(|value| value.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(orientated(orient), orientated(orient_row));
    }
}
