//! Adding a frame to blocks of voxels.
//!
//! A voxel is projected into the frame. Between four measured pixels inverse depth is interpolated, which is exact on planes;
//! where one is missing (beside a jump they are) the nearest pixel counts. What lies between that depth and the voxel's own,
//! along the surface's normal there, is added to the voxel: cut off at one truncation before the surface, and not at
//! all farther behind it, which says nothing (Curless and Levoy, "A volumetric method for building complex models from
//! range images", 1996). Behind the surface it counts in full as far as its noise may reach, and less and less from there on:
//! what others see there is the other side of something thin, which would be pushed away and torn.
//!
//! A slice of 64 voxels goes through one step after another, so that each step is a loop without branches. What comes
//! out is the same to the bit in every set of instructions: products and sums are rounded one by one, quotients exactly.

use super::blocks::Written;
use super::field::SIDE;
use super::view::View;
use super::voxel::{COLOR_FRAMES, COLORED, Colors, FRACTIONS, SLICE, UNIT};
use crate::base::parallel::each;

/// Blocks that a thread takes at once.
const AT_ONCE: usize = 16;

/// A surface that is so many truncations behind a voxel is another one than that which the voxel may be at. Then the frame does
/// not count as one that saw the voxel, or the field would be closed beside silhouettes, where no frame saw the other side.
const OTHER: f32 = 8.0;

/// A measurement counts in full so many standard deviations of it behind the surface, and no less than so many voxels; within so many
/// voxels more it falls to the least weight there is, so that the surface has a far side even where nobody has seen it.
const SURE: f32 = 3.0;
const SURE_VOXELS: f32 = 0.5;
const FADING_VOXELS: f32 = 1.5;

/// A frame and how voxels are projected into it: the homogeneous pixel (u z, v z, z) of a voxel is an affine function of its
/// coordinates.
#[derive(Debug)]
pub struct Frame<'a> {
    view: &'a View,
    /// Of the voxel at the origin.
    origin: [f64; 3],
    /// From one voxel to the next along x, y and z.
    step: [[f64; 3]; 3],
    /// Of the voxels of a slice, from its first.
    within: [[f32; SLICE]; 3],
    behind: Behind,
}

/// How much less what is behind the surface counts; lengths in truncations.
#[derive(Clone, Copy, Debug)]
struct Behind {
    /// What is sure of depth z: at least so much, and constant + quadratic z².
    least: f32,
    constant: f32,
    quadratic: f32,
    /// From what is sure on, the share that is lost in one truncation.
    steepness: f32,
}

impl Behind {
    fn new(view: &View, voxel_size: f64) -> Self {
        let voxel = voxel_size as f32 / view.truncation;
        let sure = SURE / view.truncation;
        Self {
            least: SURE_VOXELS * voxel,
            constant: sure * view.weighing.constant,
            quadratic: sure * view.weighing.quadratic,
            steepness: 1.0 / (FADING_VOXELS * voxel),
        }
    }

    /// The share of its weight that a measurement of depth z has, at a distance in front of its surface.
    #[inline(always)]
    fn share(&self, distance: f32, z: f32) -> f32 {
        let noise = self.constant + self.quadratic * (z * z);
        let sure = if noise > self.least { noise } else { self.least };
        let share = 1.0 + (distance + sure) * self.steepness;
        let share = if share < 1.0 { share } else { 1.0 };
        if share > 0.0 { share } else { 0.0 }
    }
}

impl<'a> Frame<'a> {
    pub fn new(view: &'a View, voxel_size: f64) -> Self {
        let camera = &view.camera;
        let row = |i: usize, k: usize| {
            let [own, depth] = [camera.inverse[i][k], camera.inverse[2][k]];
            if i < 2 { camera.focal[i] * own + camera.centre[i] * depth } else { depth }
        };
        let step = [0, 1, 2].map(|axis| [0, 1, 2].map(|i| row(i, axis) * voxel_size));
        let within = [0, 1, 2].map(|i| {
            std::array::from_fn(|k| (step[0][i] * (k % SIDE) as f64 + step[1][i] * (k / SIDE) as f64) as f32)
        });
        Self {
            view,
            origin: [0, 1, 2].map(|i| row(i, 3)),
            step,
            within,
            behind: Behind::new(view, voxel_size),
        }
    }

    /// Homogeneous pixel of the first voxel of a block's slice.
    fn first(&self, block: [i32; 3], slice: usize) -> [f32; 3] {
        let at = block.map(|c| f64::from(c) * SIDE as f64);
        let at = [at[0], at[1], at[2] + slice as f64];
        [0, 1, 2].map(|i| {
            let along = self.step[0][i] * at[0] + self.step[1][i] * at[1] + self.step[2][i] * at[2];
            (self.origin[i] + along) as f32
        })
    }
}

/// One version of [`add`].
pub type Add = fn(&Frame<'_>, &mut Written<'_>);

/// The versions of [`add`] that this processor can run, the widest first; all do the same.
pub fn versions() -> Vec<(&'static str, Add)> {
    let mut versions: Vec<(&'static str, Add)> = vec![];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
        {
            // SAFETY: the processor has these instructions.
            versions.push(("AVX-512", |frame, block| unsafe { with_avx512(frame, block) }));
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has these instructions.
            versions.push(("AVX2", |frame, block| unsafe { with_avx2(frame, block) }));
        }
    }
    versions.push(("plain", |frame, block| add(frame, block)));
    versions
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
fn with_avx512(frame: &Frame<'_>, block: &mut Written<'_>) {
    add(frame, block);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2(frame: &Frame<'_>, block: &mut Written<'_>) {
    add(frame, block);
}

/// Add a frame to some blocks.
pub fn integrate(frame: &Frame<'_>, mut blocks: Vec<Written<'_>>, add: Add, threads: usize) {
    let parts = blocks.chunks_mut(AT_ONCE).collect();
    each(parts, threads, |part: &mut [Written<'_>]| {
        for block in part {
            add(frame, block);
        }
    });
}

/// A number for each voxel of a slice.
type Slice<T> = [T; SLICE];

/// Where the voxels of a slice are in the image.
struct Projected {
    /// Depth; not above 0 for what is not in the image.
    z: Slice<f32>,
    /// The pixel to the upper left, and how far right and below of it.
    upper_left: Slice<u32>,
    right: Slice<f32>,
    below: Slice<f32>,
    nearest: Slice<u32>,
}

#[inline(always)]
fn add(frame: &Frame<'_>, block: &mut Written<'_>) {
    let mut at = Projected {
        z: [0.0; SLICE],
        upper_left: [0; SLICE],
        right: [0.0; SLICE],
        below: [0.0; SLICE],
        nearest: [0; SLICE],
    };
    let (mut distance, mut looks) = ([0.0; SLICE], [0; SLICE]);
    let (mut own, mut total) = ([0; SLICE], [0.0; SLICE]);
    for slice in 0..SIDE {
        project(frame, frame.first(block.block, slice), &mut at);
        if !any(&at.z, |z| z > 0.0) {
            continue;
        }
        measure(frame.view, &at, &mut distance);
        if !any(&distance, |d| d > -1.0) {
            continue;
        }
        fetch(&frame.view.looks, &at.nearest, &mut looks);
        fade(&frame.behind, &at.z, &distance, &looks, &mut own);
        let to = &mut *block.distances;
        weigh(&mut to.sum[slice], &mut to.weight[slice], &mut to.frames[slice], &distance, &own, &mut total);
        if let Some(colors) = &mut block.colors
            && any(&distance, |d| d.abs() < 1.0)
        {
            paint(colors, slice, &distance, &looks, &own, &total);
        }
    }
}

#[inline(always)]
fn any(values: &Slice<f32>, is_one: impl Fn(f32) -> bool) -> bool {
    values.iter().fold(false, |any, &value| any | is_one(value))
}

/// Project a slice whose first voxel has a homogeneous pixel.
#[inline(always)]
fn project(frame: &Frame<'_>, first: [f32; 3], to: &mut Projected) {
    let camera = &frame.view.camera;
    let (last_x, last_y) = ((camera.width - 1) as f32, (camera.height - 1) as f32);
    let stride = frame.view.stride() as u32;
    let [within_u, within_v, within_z] = &frame.within;
    for i in 0..SLICE {
        let z = first[2] + within_z[i];
        let inverse = 1.0 / z;
        let (u, v) = ((first[0] + within_u[i]) * inverse, (first[1] + within_v[i]) * inverse);
        // To the outer edges of the pixels; false for what is not a number.
        let is_inside = (z > 0.0) & (u >= -0.5) & (u < last_x + 0.5) & (v >= -0.5) & (v < last_y + 0.5);
        let (u, v) = (clamped(u, last_x), clamped(v, last_y));
        // SAFETY: both are numbers from 0 to below 2³⁰.
        let (left, above, column, row) = unsafe { (whole(u), whole(v), whole(u + 0.5), whole(v + 0.5)) };
        to.z[i] = if is_inside { z } else { 0.0 };
        to.upper_left[i] = above as u32 * stride + left as u32;
        to.right[i] = u - left as f32;
        to.below[i] = v - above as f32;
        to.nearest[i] = row as u32 * stride + column as u32;
    }
}

/// From 0 to `last`, and 0 for what is not a number.
#[inline(always)]
fn clamped(x: f32, last: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < last { x } else { last }
}

/// Cut the fraction off.
///
/// # Safety
/// It must be a number of a size below 2³¹.
#[inline(always)]
unsafe fn whole(x: f32) -> i32 {
    // SAFETY: as promised by the caller.
    unsafe { x.to_int_unchecked() }
}

/// How far in front of the surface voxels are along its normal, in truncations; −∞ where there is none.
#[inline(always)]
fn measure(view: &View, at: &Projected, distance: &mut Slice<f32>) {
    let mut sides = [[0.0; 4]; SLICE];
    fetch_sides(view, &at.upper_left, &at.below, &mut sides);
    let mut is_missing = false;
    for i in 0..SLICE {
        let [left, left_scale, right, right_scale] = sides[i];
        let inverse = left + at.right[i] * (right - left);
        let scale = left_scale + at.right[i] * (right_scale - left_scale);
        let (is_inside, is_known) = (at.z[i] > 0.0, inverse > 0.0);
        let found = (1.0 / inverse - at.z[i]) * scale;
        distance[i] = if is_inside & is_known { found } else { f32::NEG_INFINITY };
        is_missing |= is_inside & !is_known;
    }
    if is_missing {
        let mut nearest = [[0.0; 2]; SLICE];
        fetch(&view.measures, &at.nearest, &mut nearest);
        for i in 0..SLICE {
            let [inverse, scale] = nearest[i];
            let is_open = (at.z[i] > 0.0) & (distance[i] == f32::NEG_INFINITY) & (inverse > 0.0);
            let found = (1.0 / inverse - at.z[i]) * scale;
            distance[i] = if is_open { found } else { distance[i] };
        }
    }
}

// What is fetched from the image, is so in functions of their own, which are compiled for all processors alike: compilers
// would take the instructions that gather, which are slower than loads one by one.

/// Measures to the left and right of voxels, interpolated between the rows.
#[inline(never)]
fn fetch_sides(view: &View, upper_left: &Slice<u32>, below: &Slice<f32>, to: &mut Slice<[f32; 4]>) {
    let stride = view.stride();
    for i in 0..SLICE {
        let pixel = upper_left[i] as usize;
        // SAFETY: `project` names pixels of the image alone, and there are one more row and column than it has.
        let [above, under] = unsafe {
            let first = view.measures.as_ptr().add(pixel);
            [*first.cast::<[f32; 4]>(), *first.add(stride).cast::<[f32; 4]>()]
        };
        for k in 0..4 {
            to[i][k] = above[k] + below[i] * (under[k] - above[k]);
        }
    }
}

/// What the nearest pixels have, of images with as many as the measures.
#[inline(never)]
fn fetch<T: Copy>(image: &[T], pixels: &Slice<u32>, to: &mut Slice<T>) {
    for i in 0..SLICE {
        // SAFETY: `project` names pixels of the image alone.
        to[i] = unsafe { *image.get_unchecked(pixels[i] as usize) };
    }
}

/// What the measurements of a slice weigh, behind the surface less.
#[inline(always)]
fn fade(behind: &Behind, z: &Slice<f32>, distance: &Slice<f32>, looks: &Slice<u32>, own: &mut Slice<u32>) {
    for i in 0..SLICE {
        let weight = (looks[i] >> 24) as i32 as f32 * behind.share(distance[i], z[i]);
        // SAFETY: it is a number from 0 to 255.
        own[i] = unsafe { whole(weight + 0.5) }.max(1) as u32;
    }
}

/// Add distances to those of a slice, and tell the sums of weights.
#[inline(always)]
fn weigh(
    sums: &mut Slice<f32>,
    weights: &mut Slice<u16>,
    frames: &mut Slice<u8>,
    distance: &Slice<f32>,
    own: &Slice<u32>,
    total: &mut Slice<f32>,
) {
    let (mut new, mut near) = ([0u32; SLICE], [0u32; SLICE]);
    for i in 0..SLICE {
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
        near[i] = u32::from(is_seen & (d < OTHER));
    }
    for i in 0..SLICE {
        weights[i] = new[i] as u16;
    }
    for i in 0..SLICE {
        frames[i] = frames[i].saturating_add(near[i] as u8);
    }
}

/// Mix the colours of pixels with those of voxels within one truncation of the surface.
#[inline(always)]
fn paint(
    to: &mut Colors,
    slice: usize,
    distance: &Slice<f32>,
    looks: &Slice<u32>,
    own: &Slice<u32>,
    total: &Slice<f32>,
) {
    let fractions = &mut to.fractions[slice];
    let (mut share, mut near) = ([0f32; SLICE], [0u32; SLICE]);
    for i in 0..SLICE {
        let (d, most) = (distance[i], COLOR_FRAMES * UNIT);
        near[i] = if (d > -1.0) & (d < 1.0) { u32::MAX } else { 0 };
        let of = if total[i] < most { total[i] } else { most };
        let own = own[i] as i32 as f32 / of;
        // The first colour is taken as it is, whatever the weight of the space that was seen empty before.
        share[i] = if fractions[i] & COLORED == 0 { 1.0 } else { own };
    }
    let mut parts = [u32::from(COLORED); SLICE];
    for (channel, levels) in to.levels.iter_mut().enumerate() {
        let levels = &mut levels[slice];
        let mut mixed = [0u32; SLICE];
        for i in 0..SLICE {
            let fraction = u32::from(fractions[i]) >> (5 * channel) & 31;
            let old = (u32::from(levels[i]) << 5 | fraction) as i32 as f32;
            let seen = (looks[i] >> (8 * channel) & 255) as i32 as f32 * FRACTIONS;
            // SAFETY: it lies between both, which are numbers from 0 to 2¹³.
            mixed[i] = unsafe { whole(old + share[i] * (seen - old) + 0.5) } as u32;
        }
        for i in 0..SLICE {
            parts[i] |= (mixed[i] & 31) << (5 * channel);
        }
        for i in 0..SLICE {
            levels[i] = (mixed[i] >> 5 & near[i] | u32::from(levels[i]) & !near[i]) as u8;
        }
    }
    for i in 0..SLICE {
        fractions[i] = (parts[i] & near[i] | u32::from(fractions[i]) & !near[i]) as u16;
    }
}
