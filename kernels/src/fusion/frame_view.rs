//! Frame prepared for integration: inverse depth, weight and colour of each pixel.

use super::planarity::{CELL_PIXELS, Planarity};
use super::voxel_data::{MAX_WEIGHT, WEIGHT_UNIT};
use crate::base::by_processor::by_processor;
use crate::base::geometry::{cross, dot};
use crate::base::parallel::for_each_part;

/// Pinhole camera without distortion, with its pose.
#[derive(Clone, Copy, Debug)]
pub struct FusionCamera {
    pub width: usize,
    pub height: usize,
    /// Focal lengths along x and y, and the principal point, in pixels.
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    /// Camera-to-world transform (camera axes x right, y down, z forward), and its inverse.
    pub pose: Affine,
    pub inverse: Affine,
}

/// The first three rows of a homogeneous 4 × 4 matrix.
pub type Affine = [[f64; 4]; 3];

impl FusionCamera {
    /// Create a camera. `pose` must be nearly a rigid transform.
    pub fn new((width, height): (usize, usize), focal: [f64; 2], centre: [f64; 2], pose: Affine) -> Self {
        Self { width, height, focal, centre, pose, inverse: invert_pose(&pose) }
    }
}

fn invert_pose(pose: &Affine) -> Affine {
    let column = |k: usize| [0, 1, 2].map(|i| pose[i][k]);
    let [a, b, c] = [0, 1, 2].map(column);
    let volume = dot(&a, &cross(&b, &c));
    let rows = [cross(&b, &c), cross(&c, &a), cross(&a, &b)].map(|row| row.map(|x| x / volume));
    rows.map(|row| [row[0], row[1], row[2], -dot(&row, &column(3))])
}

/// Depth noise model. The weight of a measurement at depth z is (typical / (constant + quadratic z²))². On
/// curved surfaces it is multiplied by the squared cosine of the viewing angle.
#[derive(Clone, Copy, Debug)]
pub struct DepthNoiseModel {
    /// Standard deviation along the normal, in metres, that gets weight 1.
    pub typical: f32,
    /// Standard deviation of depth z in metres is constant + quadratic z²: in metres, and in metres per
    /// square metre.
    pub constant: f32,
    pub quadratic: f32,
}

/// Images with the size of the camera, row by row.
#[derive(Clone, Copy, Debug)]
pub struct FrameImages<'a> {
    /// Depth in metres, not positive where missing.
    pub depth: &'a [f32],
    /// Metres along the optical axis per metre along the surface normal.
    pub obliqueness: &'a [f32],
    /// RGB of each pixel, interleaved.
    pub color: Option<&'a [u8]>,
}

/// Inverse depth (NaN where missing), and truncations along the normal per metre along the optical axis.
pub type PixelMeasure = [f32; 2];

/// Frame that voxels are projected into. Rows are one pixel longer than the image, and there is one more row,
/// so that every pixel has neighbours for interpolation.
#[derive(Debug)]
pub struct FrameView {
    pub camera: FusionCamera,
    pub measures: Vec<PixelMeasure>,
    /// Red, green, blue from the lowest byte, then the weight in [`UNIT`]s.
    pub packed_colors: Vec<u32>,
    pub weighing: DepthNoiseModel,
    pub truncation: f32,
}

impl FrameView {
    /// Prepare images for a volume with a truncation in metres along the normal.
    pub fn new(
        camera: FusionCamera,
        images: FrameImages<'_>,
        weighing: DepthNoiseModel,
        truncation: f32,
        threads: usize,
    ) -> Self {
        let (width, height) = (camera.width, camera.height);
        let stride = width + 1;
        let mut measures = vec![[f32::NAN, 1.0]; stride * (height + 1)];
        let mut looks = vec![0u32; stride * (height + 1)];
        let flatness = Planarity::new(images.depth, width, height);
        let rows = measures.chunks_mut(stride).zip(looks.chunks_mut(stride)).take(height).enumerate();
        // Contiguous rows per thread.
        let mut parts: Vec<Vec<_>> = (0..threads.max(1)).map(|_| vec![]).collect();
        rows.for_each(|row| parts[row.0 * threads.max(1) / height].push(row));
        for_each_part(parts, threads, |rows| {
            for (y, (measures, looks)) in rows {
                let own = y * width..(y + 1) * width;
                let row = ImageRow {
                    depth: &images.depth[own.clone()],
                    obliqueness: &images.obliqueness[own.clone()],
                    flatness: flatness.row(y),
                    color: images.color.map(|color| &color[3 * own.start..3 * own.end]),
                };
                prepare_row(row, weighing, truncation, measures, looks);
                measures[width] = measures[width - 1];
            }
        });
        let (above, last) = measures.split_at_mut(stride * height);
        last.copy_from_slice(&above[stride * (height - 1)..]);
        Self { camera, measures, packed_colors: looks, weighing, truncation }
    }

    /// Return the number of pixels from one row to the next.
    #[inline]
    pub fn stride(&self) -> usize {
        self.camera.width + 1
    }
}

/// One row of the images.
#[derive(Clone, Copy)]
struct ImageRow<'a> {
    depth: &'a [f32],
    obliqueness: &'a [f32],
    flatness: &'a [f32],
    color: Option<&'a [u8]>,
}

by_processor! {
    fn prepare_row(row: ImageRow<'_>, weighing: DepthNoiseModel, truncation: f32, measures: &mut [PixelMeasure], looks: &mut [u32]) = prepare_pixels
}

#[inline(always)]
fn prepare_pixels(
    row: ImageRow<'_>,
    weighing: DepthNoiseModel,
    truncation: f32,
    measures: &mut [PixelMeasure],
    looks: &mut [u32],
) {
    let width = row.depth.len();
    let (depth, obliqueness) = (&row.depth[..width], &row.obliqueness[..width]);
    let (measures, looks) = (&mut measures[..width], &mut looks[..width]);
    for x in 0..width {
        let (z, oblique) = (depth[x], obliqueness[x]);
        let inverse = 1.0 / z;
        let is_there = z > 0.0 && inverse > 0.0 && inverse < f32::MAX && oblique > 0.0 && oblique < f32::MAX;
        measures[x] = [if is_there { inverse } else { f32::NAN }, 1.0 / (oblique * truncation)];
        let share = weighing.typical / (weighing.constant + weighing.quadratic * (z * z));
        let flat = row.flatness[x / CELL_PIXELS];
        let worth = flat + (1.0 - flat) / (oblique * oblique);
        // Weight 1 for NaN, because a measurement without weight would have no colour either.
        let weight = (WEIGHT_UNIT * (share * share) * worth + 0.5).clamp(1.0, MAX_WEIGHT) as u32;
        looks[x] = weight.max(1) << 24;
    }
    if let Some(color) = row.color {
        for (look, color) in looks.iter_mut().zip(color.chunks_exact(3)) {
            *look |= u32::from(color[0]) | u32::from(color[1]) << 8 | u32::from(color[2]) << 16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_and_its_inverse_cancel() {
        let pose = [[0.6, -0.8, 0.0, 3.0], [0.8, 0.6, 0.0, -1.0], [0.0, 0.0, 1.0, 7.0]];
        let camera = FusionCamera::new((4, 3), [5.0, 5.0], [2.0, 1.0], pose);
        let apply = |m: &Affine, p: [f64; 3]| m.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);
        let back = apply(&camera.inverse, apply(&pose, [0.3, -0.2, 2.5]));
        assert!((0..3).all(|k| (back[k] - [0.3, -0.2, 2.5][k]).abs() < 1e-12));
    }

    #[test]
    fn what_is_measured_weighs_something_however_far_it_is() {
        let row = ImageRow { depth: &[2e19, 1.0], obliqueness: &[1.0; 2], flatness: &[1.0], color: None };
        let weighing = DepthNoiseModel { typical: 1.0, constant: 1.0, quadratic: 0.0 };
        let (mut measures, mut looks) = ([[0.0; 2]; 2], [0; 2]);
        prepare_row(row, weighing, 0.07, &mut measures, &mut looks);
        assert_eq!(looks.map(|look| look >> 24), [1, WEIGHT_UNIT as u32]);
    }

    #[test]
    fn wide_instructions_give_the_bits_of_plain_ones() {
        let width = 101;
        let depth: Vec<f32> =
            (0..width).map(|x| if x % 7 == 0 { 0.0 } else { 0.3 + 0.113 * x as f32 }).collect();
        let obliqueness: Vec<f32> = (0..width).map(|x| 1.0 + (x * 37 % 90) as f32 / 11.0).collect();
        let flatness: Vec<f32> = (0..width).map(|x| (x % 5) as f32 / 4.0).collect();
        let color: Vec<u8> = (0..3 * width).map(|i| (i * 29 % 256) as u8).collect();
        let row =
            ImageRow { depth: &depth, obliqueness: &obliqueness, flatness: &flatness, color: Some(&color) };
        let weighing = DepthNoiseModel { typical: 0.01, constant: 0.002, quadratic: 0.003 };
        let run = |prepare: fn(ImageRow<'_>, DepthNoiseModel, f32, &mut [PixelMeasure], &mut [u32])| {
            let (mut measures, mut looks) = (vec![[0.0; 2]; width], vec![0; width]);
            prepare(row, weighing, 0.07, &mut measures, &mut looks);
            (measures.as_flattened().iter().map(|m| m.to_bits()).collect::<Vec<_>>(), looks)
        };
        let (measures, looks) = run(prepare_row);
        assert_eq!((measures, looks.clone()), run(prepare_pixels));
        assert!(looks.iter().any(|look| look >> 24 == 255) && looks.iter().any(|look| look >> 24 < 9));
    }
}
