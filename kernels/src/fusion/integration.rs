//! TSDF integration of a frame into blocks of voxels.
//!
//! Each voxel is projected into the frame. Inverse depth is interpolated between four measured pixels, which
//! is exact on planes. If one of them is missing, which is always so at a discontinuity, the nearest pixel is
//! used. The signed distance is the depth difference converted to a distance along the surface normal. It is
//! clamped to one truncation in front of the surface. Voxels more than one truncation behind it are not
//! updated (Curless and Levoy, "A volumetric method for building complex models from range images", 1996).
//! Behind the surface, the weight is full within the noise of the measurement and then decreases: frames that
//! see this space from the other side observe the back of a thin object, which would otherwise be displaced
//! and torn.
//!
//! A slice of 64 voxels passes through one step after another, so that each step is a loop without branches.
//! Results are identical to the bit with every instruction set: products and sums are rounded one by one,
//! divisions exactly.

use super::block_storage::BlockMut;
use super::distance_field::BLOCK_SIDE;
use super::frame_view::FrameView;
use super::voxel_data::{BlockColors, COLOR_FRACTIONS, COLOR_FRAMES, HAS_COLOR, SLICE_VOXELS, WEIGHT_UNIT};
use crate::base::parallel::for_each_part;

/// Blocks that a thread processes at once.
const BLOCKS_PER_TASK: usize = 16;

/// If the observed surface is more than this many truncations behind the voxel, it is another surface. The
/// frame then does not count as an observation of the voxel. Counting it would close the field next to
/// silhouettes whose far side no frame saw.
const OTHER_SURFACE_TRUNCATIONS: f32 = 8.0;

/// A measurement has full weight up to `FULL_WEIGHT_DEVIATIONS` standard deviations behind the surface, and at least
/// `MIN_FULL_WEIGHT_VOXELS` voxels. Within `FADING_VOXELS` more, the weight decreases to its minimum, so that the
/// surface gets a back side even where no frame saw it.
const FULL_WEIGHT_DEVIATIONS: f32 = 3.0;
const MIN_FULL_WEIGHT_VOXELS: f32 = 0.5;
const FADING_VOXELS: f32 = 1.5;

/// A frame, and the projection of voxels into it. The homogeneous pixel (u z, v z, z) of a voxel is an affine
/// function of its coordinates.
#[derive(Debug)]
pub struct ProjectedFrame<'a> {
    view: &'a FrameView,
    /// Homogeneous pixel of the voxel at the origin.
    origin: [f64; 3],
    /// Change of the homogeneous pixel from one voxel to the next along x, y and z.
    step: [[f64; 3]; 3],
    /// Offset of the homogeneous pixel of each voxel of a slice from its first voxel.
    slice_offsets: [[f32; SLICE_VOXELS]; 3],
    behind: FadeBehindSurface,
}

/// Weight reduction behind the surface. Lengths are in truncations.
#[derive(Clone, Copy, Debug)]
struct FadeBehindSurface {
    /// Full-weight range behind the surface at depth z: max(least, constant + quadratic z²).
    min_range: f32,
    constant: f32,
    quadratic: f32,
    /// Loss of relative weight per truncation beyond the full-weight range.
    steepness: f32,
}

impl FadeBehindSurface {
    fn new(view: &FrameView, voxel_size: f64) -> Self {
        let voxel = voxel_size as f32 / view.truncation;
        let sure = FULL_WEIGHT_DEVIATIONS / view.truncation;
        Self {
            min_range: MIN_FULL_WEIGHT_VOXELS * voxel,
            constant: sure * view.weighing.constant,
            quadratic: sure * view.weighing.quadratic,
            steepness: 1.0 / (FADING_VOXELS * voxel),
        }
    }

    /// Compute the weight factor (0 to 1) of a measurement at depth z, for a voxel at a signed distance in
    /// front of the surface.
    #[inline(always)]
    fn weight_factor(&self, distance: f32, z: f32) -> f32 {
        let noise = self.constant + self.quadratic * (z * z);
        let sure = if noise > self.min_range { noise } else { self.min_range };
        let share = 1.0 + (distance + sure) * self.steepness;
        let share = if share < 1.0 { share } else { 1.0 };
        if share > 0.0 { share } else { 0.0 }
    }
}

impl<'a> ProjectedFrame<'a> {
    /// Prepare the projection of voxels into a frame.
    pub fn new(view: &'a FrameView, voxel_size: f64) -> Self {
        let camera = &view.camera;
        let row = |i: usize, k: usize| {
            let [own, depth] = [camera.inverse[i][k], camera.inverse[2][k]];
            if i < 2 { camera.focal[i] * own + camera.centre[i] * depth } else { depth }
        };
        let step = [0, 1, 2].map(|axis| [0, 1, 2].map(|i| row(i, axis) * voxel_size));
        let within = [0, 1, 2].map(|i| {
            std::array::from_fn(|k| {
                (step[0][i] * (k % BLOCK_SIDE) as f64 + step[1][i] * (k / BLOCK_SIDE) as f64) as f32
            })
        });
        Self {
            view,
            origin: [0, 1, 2].map(|i| row(i, 3)),
            step,
            slice_offsets: within,
            behind: FadeBehindSurface::new(view, voxel_size),
        }
    }

    /// Compute the homogeneous pixel of the first voxel of a block's slice.
    fn first_of_slice(&self, block: [i32; 3], slice: usize) -> [f32; 3] {
        let at = block.map(|c| f64::from(c) * BLOCK_SIDE as f64);
        let at = [at[0], at[1], at[2] + slice as f64];
        [0, 1, 2].map(|i| {
            let along = self.step[0][i] * at[0] + self.step[1][i] * at[1] + self.step[2][i] * at[2];
            (self.origin[i] + along) as f32
        })
    }
}

/// One variant of [`integrate_block`].
pub type IntegrateBlock = fn(&ProjectedFrame<'_>, &mut BlockMut<'_>);

/// List the variants of [`integrate_block`] that this processor supports, widest instructions first. All give identical
/// results.
pub fn instruction_variants() -> Vec<(&'static str, IntegrateBlock)> {
    let mut versions: Vec<(&'static str, IntegrateBlock)> = vec![];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
        {
            // SAFETY: the processor supports these instructions.
            versions.push(("AVX-512", |frame, block| unsafe { with_avx512(frame, block) }));
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor supports these instructions.
            versions.push(("AVX2", |frame, block| unsafe { with_avx2(frame, block) }));
        }
    }
    versions.push(("plain", |frame, block| integrate_block(frame, block)));
    versions
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
fn with_avx512(frame: &ProjectedFrame<'_>, block: &mut BlockMut<'_>) {
    integrate_block(frame, block);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2(frame: &ProjectedFrame<'_>, block: &mut BlockMut<'_>) {
    integrate_block(frame, block);
}

/// Integrate a frame into blocks.
pub fn integrate(
    frame: &ProjectedFrame<'_>,
    mut blocks: Vec<BlockMut<'_>>,
    add: IntegrateBlock,
    threads: usize,
) {
    let parts = blocks.chunks_mut(BLOCKS_PER_TASK).collect();
    for_each_part(parts, threads, |part: &mut [BlockMut<'_>]| {
        for block in part {
            add(frame, block);
        }
    });
}

/// One value per voxel of a slice.
type Slice<T> = [T; SLICE_VOXELS];

/// Projection of the voxels of a slice.
struct ProjectedSlice {
    /// Depth of the voxel; 0 if it is outside the image or behind the camera.
    z: Slice<f32>,
    /// Index of the pixel to the upper left, and the fractional offsets to the right and below.
    upper_left: Slice<u32>,
    right: Slice<f32>,
    below: Slice<f32>,
    nearest: Slice<u32>,
}

#[inline(always)]
fn integrate_block(frame: &ProjectedFrame<'_>, block: &mut BlockMut<'_>) {
    let mut at = ProjectedSlice {
        z: [0.0; SLICE_VOXELS],
        upper_left: [0; SLICE_VOXELS],
        right: [0.0; SLICE_VOXELS],
        below: [0.0; SLICE_VOXELS],
        nearest: [0; SLICE_VOXELS],
    };
    let (mut distance, mut looks) = ([0.0; SLICE_VOXELS], [0; SLICE_VOXELS]);
    let (mut own, mut total) = ([0; SLICE_VOXELS], [0.0; SLICE_VOXELS]);
    for slice in 0..BLOCK_SIDE {
        project_slice(frame, frame.first_of_slice(block.block, slice), &mut at);
        if !any_voxel(&at.z, |z| z > 0.0) {
            continue;
        }
        measure_distances(frame.view, &at, &mut distance);
        if !any_voxel(&distance, |d| d > -1.0) {
            continue;
        }
        fetch_nearest(&frame.view.packed_colors, &at.nearest, &mut looks);
        weaken_behind_surface(&frame.behind, &at.z, &distance, &looks, &mut own);
        let to = &mut *block.distances;
        accumulate_distances(
            &mut to.sum[slice],
            &mut to.weight[slice],
            &mut to.frames[slice],
            &distance,
            &own,
            &mut total,
        );
        if let Some(colors) = &mut block.colors
            && any_voxel(&distance, |d| d.abs() < 1.0)
        {
            blend_colors(colors, slice, &distance, &looks, &own, &total);
        }
    }
}

#[inline(always)]
fn any_voxel(values: &Slice<f32>, is_one: impl Fn(f32) -> bool) -> bool {
    values.iter().fold(false, |any, &value| any | is_one(value))
}

/// Project a slice, given the homogeneous pixel of its first voxel.
#[inline(always)]
fn project_slice(frame: &ProjectedFrame<'_>, first: [f32; 3], to: &mut ProjectedSlice) {
    let camera = &frame.view.camera;
    let (last_x, last_y) = ((camera.width - 1) as f32, (camera.height - 1) as f32);
    let stride = frame.view.stride() as u32;
    let [within_u, within_v, within_z] = &frame.slice_offsets;
    for i in 0..SLICE_VOXELS {
        let z = first[2] + within_z[i];
        let inverse = 1.0 / z;
        let (u, v) = ((first[0] + within_u[i]) * inverse, (first[1] + within_v[i]) * inverse);
        // Up to the outer edges of the pixels; false for NaN.
        let is_inside = (z > 0.0) & (u >= -0.5) & (u < last_x + 0.5) & (v >= -0.5) & (v < last_y + 0.5);
        let (u, v) = (clamp_coordinate(u, last_x), clamp_coordinate(v, last_y));
        // SAFETY: both are numbers from 0 to below 2³⁰.
        let (left, above, column, row) =
            unsafe { (truncate(u), truncate(v), truncate(u + 0.5), truncate(v + 0.5)) };
        to.z[i] = if is_inside { z } else { 0.0 };
        to.upper_left[i] = above as u32 * stride + left as u32;
        to.right[i] = u - left as f32;
        to.below[i] = v - above as f32;
        to.nearest[i] = row as u32 * stride + column as u32;
    }
}

/// Clamp to the range from 0 to `last`; NaN becomes 0.
#[inline(always)]
fn clamp_coordinate(x: f32, last: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < last { x } else { last }
}

/// Truncate to an integer.
///
/// # Safety
/// `x` must be a number with an absolute value below 2³¹.
#[inline(always)]
unsafe fn truncate(x: f32) -> i32 {
    // SAFETY: as promised by the caller.
    unsafe { x.to_int_unchecked() }
}

/// Compute the signed distance of each voxel in front of the surface along its normal, in truncations; −∞
/// without a measurement.
#[inline(always)]
fn measure_distances(view: &FrameView, at: &ProjectedSlice, distance: &mut Slice<f32>) {
    let mut sides = [[0.0; 4]; SLICE_VOXELS];
    fetch_interpolated(view, &at.upper_left, &at.below, &mut sides);
    let mut is_missing = false;
    for i in 0..SLICE_VOXELS {
        let [left, left_scale, right, right_scale] = sides[i];
        let inverse = left + at.right[i] * (right - left);
        let scale = left_scale + at.right[i] * (right_scale - left_scale);
        let (is_inside, is_known) = (at.z[i] > 0.0, inverse > 0.0);
        let found = (1.0 / inverse - at.z[i]) * scale;
        distance[i] = if is_inside & is_known { found } else { f32::NEG_INFINITY };
        is_missing |= is_inside & !is_known;
    }
    if is_missing {
        let mut nearest = [[0.0; 2]; SLICE_VOXELS];
        fetch_nearest(&view.measures, &at.nearest, &mut nearest);
        for i in 0..SLICE_VOXELS {
            let [inverse, scale] = nearest[i];
            let is_open = (at.z[i] > 0.0) & (distance[i] == f32::NEG_INFINITY) & (inverse > 0.0);
            let found = (1.0 / inverse - at.z[i]) * scale;
            distance[i] = if is_open { found } else { distance[i] };
        }
    }
}

// Image reads are in separate functions, compiled for the baseline instruction set: otherwise compilers emit
// gather instructions, which are slower than single loads.

/// Read the measures to the left and right of each voxel, interpolated between the two rows.
#[inline(never)]
fn fetch_interpolated(
    view: &FrameView,
    upper_left: &Slice<u32>,
    below: &Slice<f32>,
    to: &mut Slice<[f32; 4]>,
) {
    let stride = view.stride();
    for i in 0..SLICE_VOXELS {
        let pixel = upper_left[i] as usize;
        // SAFETY: `project_slice` yields pixels of the image only, and the measures have one more row and column
        // than the image.
        let [above, under] = unsafe {
            let first = view.measures.as_ptr().add(pixel);
            [*first.cast::<[f32; 4]>(), *first.add(stride).cast::<[f32; 4]>()]
        };
        for k in 0..4 {
            to[i][k] = above[k] + below[i] * (under[k] - above[k]);
        }
    }
}

/// Read the nearest pixel of each voxel, from an image with the size of the measures.
#[inline(never)]
fn fetch_nearest<T: Copy>(image: &[T], pixels: &Slice<u32>, to: &mut Slice<T>) {
    for i in 0..SLICE_VOXELS {
        // SAFETY: `project_slice` yields pixels of the image only.
        to[i] = unsafe { *image.get_unchecked(pixels[i] as usize) };
    }
}

/// Compute the weight of each measurement, reduced behind the surface.
#[inline(always)]
fn weaken_behind_surface(
    behind: &FadeBehindSurface,
    z: &Slice<f32>,
    distance: &Slice<f32>,
    looks: &Slice<u32>,
    own: &mut Slice<u32>,
) {
    for i in 0..SLICE_VOXELS {
        let weight = (looks[i] >> 24) as i32 as f32 * behind.weight_factor(distance[i], z[i]);
        // SAFETY: the value is a number from 0 to 255.
        own[i] = unsafe { truncate(weight + 0.5) }.max(1) as u32;
    }
}

/// Add the weighted distances to a slice, and output the new sums of weights.
#[inline(always)]
fn accumulate_distances(
    sums: &mut Slice<f32>,
    weights: &mut Slice<u16>,
    frames: &mut Slice<u8>,
    distance: &Slice<f32>,
    own: &Slice<u32>,
    total: &mut Slice<f32>,
) {
    let (mut new, mut near) = ([0u32; SLICE_VOXELS], [0u32; SLICE_VOXELS]);
    for i in 0..SLICE_VOXELS {
        let d = distance[i];
        let is_seen = d > -1.0;
        let cut = if d < 1.0 { d } else { 1.0 };
        let (old, weight) = (u32::from(weights[i]), own[i]);
        let is_full = old + weight > u32::from(u16::MAX);
        let kept = if is_full { old >> 1 } else { old };
        let sum = if is_full { sums[i] * 0.5 } else { sums[i] };
        let added = sum + weight as i32 as f32 * cut;
        total[i] = (kept + weight) as i32 as f32;
        sums[i] = if is_seen { added } else { sums[i] };
        new[i] = if is_seen { kept + weight } else { old };
        near[i] = u32::from(is_seen & (d < OTHER_SURFACE_TRUNCATIONS));
    }
    for i in 0..SLICE_VOXELS {
        weights[i] = new[i] as u16;
    }
    for i in 0..SLICE_VOXELS {
        frames[i] = frames[i].saturating_add(near[i] as u8);
    }
}

/// Blend the pixel colours into the voxels within one truncation of the surface.
#[inline(always)]
fn blend_colors(
    to: &mut BlockColors,
    slice: usize,
    distance: &Slice<f32>,
    looks: &Slice<u32>,
    own: &Slice<u32>,
    total: &Slice<f32>,
) {
    let fractions = &mut to.fractions[slice];
    let (mut share, mut near) = ([0f32; SLICE_VOXELS], [0u32; SLICE_VOXELS]);
    for i in 0..SLICE_VOXELS {
        let (d, most) = (distance[i], COLOR_FRAMES * WEIGHT_UNIT);
        near[i] = if (d > -1.0) & (d < 1.0) { u32::MAX } else { 0 };
        let of = if total[i] < most { total[i] } else { most };
        let own = own[i] as i32 as f32 / of;
        // The first colour is copied, whatever weight the voxel has from observations of free space.
        share[i] = if fractions[i] & HAS_COLOR == 0 { 1.0 } else { own };
    }
    let mut parts = [u32::from(HAS_COLOR); SLICE_VOXELS];
    for (channel, levels) in to.levels.iter_mut().enumerate() {
        let levels = &mut levels[slice];
        let mut mixed = [0u32; SLICE_VOXELS];
        for i in 0..SLICE_VOXELS {
            let fraction = u32::from(fractions[i]) >> (5 * channel) & 31;
            let old = (u32::from(levels[i]) << 5 | fraction) as i32 as f32;
            let seen = (looks[i] >> (8 * channel) & 255) as i32 as f32 * COLOR_FRACTIONS;
            // SAFETY: the value is between the two colours, which are numbers from 0 to 2¹³.
            mixed[i] = unsafe { truncate(old + share[i] * (seen - old) + 0.5) } as u32;
        }
        for i in 0..SLICE_VOXELS {
            parts[i] |= (mixed[i] & 31) << (5 * channel);
        }
        for i in 0..SLICE_VOXELS {
            levels[i] = (mixed[i] >> 5 & near[i] | u32::from(levels[i]) & !near[i]) as u8;
        }
    }
    for i in 0..SLICE_VOXELS {
        fractions[i] = (parts[i] & near[i] | u32::from(fractions[i]) & !near[i]) as u16;
    }
}
