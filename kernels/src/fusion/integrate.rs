//! Adding a frame to blocks of voxels.
//!
//! A voxel is projected into the frame. Between four measured pixels inverse depth is interpolated, which is exact on planes;
//! where one is missing (beside a jump they are) the nearest pixel counts. What lies between that depth and the voxel's own,
//! along the surface's normal there, is added to the voxel: cut off at one truncation before the surface, and not at
//! all farther behind it, which says nothing (Curless and Levoy, "A volumetric method for building complex models from
//! range images", 1996).
//!
//! A slice of 64 voxels goes through one step after another, so that each step is a loop without branches. What comes
//! out is the same to the bit in every set of instructions: products and sums are rounded one by one, quotients exactly.

use super::blocks::Written;
use super::field::SIDE;
use super::view::View;
use super::voxel::{COLOR_FRAMES, COLORED, Colors, Distances, FRACTIONS, UNIT};
use crate::base::parallel::each;

/// Voxels of a slice.
const SLICE: usize = SIDE * SIDE;
/// Blocks that a thread takes at once.
const AT_ONCE: usize = 16;

/// How voxels are projected: the frame's homogeneous pixel of a voxel is an affine function of its coordinates.
#[derive(Clone, Copy, Debug)]
struct Projection {
    /// Of the voxel at the origin.
    origin: [f64; 3],
    /// From one voxel to the next along x, y and z.
    step: [[f64; 3]; 3],
}

impl Projection {
    fn new(view: &View, voxel_size: f64) -> Self {
        let camera = &view.camera;
        // Rows of the matrix that takes places to (u z, v z, z).
        let rows: [[f64; 4]; 3] = [0, 1, 2].map(|i| {
            [0, 1, 2, 3].map(|k| {
                let [own, depth] = [camera.inverse[i][k], camera.inverse[2][k]];
                if i < 2 { camera.focal[i] * own + camera.centre[i] * depth } else { depth }
            })
        });
        Self {
            origin: rows.map(|row| row[3]),
            step: [0, 1, 2].map(|axis| rows.map(|row| row[axis] * voxel_size)),
        }
    }

    /// Homogeneous pixel of a block's first voxel.
    fn first(&self, block: [i32; 3]) -> [f32; 3] {
        let at = block.map(|c| f64::from(c) * SIDE as f64);
        [0, 1, 2].map(|i| {
            let along = self.step[0][i] * at[0] + self.step[1][i] * at[1] + self.step[2][i] * at[2];
            (self.origin[i] + along) as f32
        })
    }
}

/// What all blocks of a frame share.
#[derive(Debug)]
pub struct Frame<'a> {
    view: &'a View,
    projection: Projection,
    /// Of the voxels of a row, from its first.
    along_x: [[f32; SIDE]; 3],
    step_y: [f32; 3],
    step_z: [f32; 3],
}

impl<'a> Frame<'a> {
    pub fn new(view: &'a View, voxel_size: f64) -> Self {
        let projection = Projection::new(view, voxel_size);
        let [x, y, z] = projection.step;
        Self {
            view,
            projection,
            along_x: x.map(|step| std::array::from_fn(|k| (step * k as f64) as f32)),
            step_y: y.map(|step| step as f32),
            step_z: z.map(|step| step as f32),
        }
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

/// Where the voxels of a slice are in the image.
struct Projected {
    /// Depth; not above 0 for what is not in the image.
    z: [f32; SLICE],
    /// The pixel to the upper left, and how far right and below of it.
    upper_left: [u32; SLICE],
    right: [f32; SLICE],
    below: [f32; SLICE],
    nearest: [u32; SLICE],
}

#[inline(always)]
fn add(frame: &Frame<'_>, block: &mut Written<'_>) {
    let first = frame.projection.first(block.block);
    let mut projected = Projected {
        z: [0.0; SLICE],
        upper_left: [0; SLICE],
        right: [0.0; SLICE],
        below: [0.0; SLICE],
        nearest: [0; SLICE],
    };
    let mut distance = [0.0; SLICE];
    for slice in 0..SIDE {
        let origin = std::array::from_fn(|i| first[i] + slice as f32 * frame.step_z[i]);
        project(frame, origin, &mut projected);
        if !projected.z.iter().fold(false, |any, &z| any | (z > 0.0)) {
            continue;
        }
        measure(frame.view, &projected, &mut distance);
        if !distance.iter().fold(false, |any, &d| any | (d > -1.0)) {
            continue;
        }
        let mut looks = [0; SLICE];
        for (look, &pixel) in looks.iter_mut().zip(&projected.nearest) {
            // SAFETY: `project` names pixels of the image alone.
            *look = unsafe { *frame.view.looks.get_unchecked(pixel as usize) };
        }
        let here = slice * SLICE..(slice + 1) * SLICE;
        let total = weigh(block.distances, here.clone(), &distance, &looks);
        if let Some(colors) = &mut block.colors
            && distance.iter().fold(false, |any, &d| any | (d.abs() < 1.0))
        {
            paint(colors, here, &distance, &looks, &total);
        }
    }
}

/// Project a slice whose first voxel has a homogeneous pixel.
#[inline(always)]
fn project(frame: &Frame<'_>, origin: [f32; 3], to: &mut Projected) {
    let camera = &frame.view.camera;
    let (last_x, last_y) = ((camera.width - 1) as f32, (camera.height - 1) as f32);
    let stride = frame.view.stride() as u32;
    let [along_u, along_v, along_z] = &frame.along_x;
    for y in 0..SIDE {
        let row: [f32; 3] = std::array::from_fn(|i| origin[i] + y as f32 * frame.step_y[i]);
        for x in 0..SIDE {
            let z = row[2] + along_z[x];
            let inverse = 1.0 / z;
            let (u, v) = ((row[0] + along_u[x]) * inverse, (row[1] + along_v[x]) * inverse);
            // To the outer edges of the pixels; false for what is not a number.
            let is_inside = (z > 0.0) & (u >= -0.5) & (u < last_x + 0.5) & (v >= -0.5) & (v < last_y + 0.5);
            let (u, v) = (clamped(u, last_x), clamped(v, last_y));
            // SAFETY: both are numbers from 0 to below 2³¹.
            let (left, above, column, line) = unsafe { (whole(u), whole(v), whole(u + 0.5), whole(v + 0.5)) };
            let i = y * SIDE + x;
            to.z[i] = if is_inside { z } else { 0.0 };
            to.upper_left[i] = above * stride + left;
            to.right[i] = u - left as f32;
            to.below[i] = v - above as f32;
            to.nearest[i] = line * stride + column;
        }
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
/// It must be a number from 0 to below 2³¹.
#[inline(always)]
unsafe fn whole(x: f32) -> u32 {
    // SAFETY: as promised by the caller.
    unsafe { x.to_int_unchecked::<i32>() as u32 }
}

/// How far in front of the surface voxels are along its normal, in truncations; −∞ where there is none.
#[inline(always)]
fn measure(view: &View, at: &Projected, distance: &mut [f32; SLICE]) {
    let stride = view.stride();
    let mut sides = [[0f32; 4]; SLICE];
    for i in 0..SLICE {
        let pixel = at.upper_left[i] as usize;
        // SAFETY: `project` names pixels of the image alone, and there are one more row and column than it has.
        let (above, below) = unsafe {
            (
                *view.measures.as_ptr().add(pixel).cast::<[f32; 4]>(),
                *view.measures.as_ptr().add(pixel + stride).cast::<[f32; 4]>(),
            )
        };
        let down = at.below[i];
        sides[i] = std::array::from_fn(|k| above[k] + down * (below[k] - above[k]));
    }
    let mut is_missing = false;
    for i in 0..SLICE {
        let [left, left_scale, right, right_scale] = sides[i];
        let inverse = left + at.right[i] * (right - left);
        let scale = left_scale + at.right[i] * (right_scale - left_scale);
        let is_inside = at.z[i] > 0.0;
        let is_known = inverse > 0.0;
        let found = (1.0 / inverse - at.z[i]) * scale;
        distance[i] = if is_inside & is_known { found } else { f32::NEG_INFINITY };
        is_missing |= is_inside & !is_known;
    }
    if is_missing {
        for i in 0..SLICE {
            if at.z[i] > 0.0 && distance[i] == f32::NEG_INFINITY {
                let [inverse, scale] = view.measures[at.nearest[i] as usize];
                if inverse > 0.0 {
                    distance[i] = (1.0 / inverse - at.z[i]) * scale;
                }
            }
        }
    }
}

/// Add distances to those of a block; the sums of weights are returned.
#[inline(always)]
fn weigh(
    to: &mut Distances,
    here: std::ops::Range<usize>,
    distance: &[f32; SLICE],
    looks: &[u32; SLICE],
) -> [f32; SLICE] {
    let (sums, weights, frames) =
        (&mut to.sum[here.clone()], &mut to.weight[here.clone()], &mut to.frames[here]);
    let mut total = [0.0; SLICE];
    for i in 0..SLICE {
        let d = distance[i];
        let is_seen = d > -1.0;
        let cut = if d < 1.0 { d } else { 1.0 };
        let weight = looks[i] >> 24;
        let old = u32::from(weights[i]);
        let is_full = old + weight > u32::from(u16::MAX);
        let (old, sum) = if is_full { (old >> 1, sums[i] * 0.5) } else { (old, sums[i]) };
        let new = old + weight;
        let added = sum + weight as i32 as f32 * cut;
        total[i] = new as i32 as f32;
        sums[i] = if is_seen { added } else { sums[i] };
        weights[i] = if is_seen { new as u16 } else { weights[i] };
        frames[i] = frames[i].saturating_add(is_seen.into());
    }
    total
}

/// Mix the colours of pixels with those of voxels within one truncation of the surface.
#[inline(always)]
fn paint(
    to: &mut Colors,
    here: std::ops::Range<usize>,
    distance: &[f32; SLICE],
    looks: &[u32; SLICE],
    total: &[f32; SLICE],
) {
    let [reds, greens, blues] = &mut to.levels;
    let (reds, greens, blues) =
        (&mut reds[here.clone()], &mut greens[here.clone()], &mut blues[here.clone()]);
    let fractions = &mut to.fractions[here];
    for i in 0..SLICE {
        let d = distance[i];
        let is_near = (d > -1.0) & (d < 1.0);
        let known = fractions[i];
        let most = COLOR_FRAMES * UNIT;
        let of = if total[i] < most { total[i] } else { most };
        let share = (looks[i] >> 24) as i32 as f32 / of;
        // The first colour is taken as it is, whatever the weight of the space that was seen empty before.
        let share = if known & COLORED == 0 { 1.0 } else { share };
        let mixed = |level: u8, fraction: u16, look: u32| {
            let old = (i32::from(level) << 5 | i32::from(fraction & 31)) as f32;
            let new = (look & 255) as i32 as f32 * FRACTIONS;
            // SAFETY: it lies between both, which are numbers from 0 to 2¹³.
            unsafe { (old + share * (new - old) + 0.5).to_int_unchecked::<i32>() as u32 }
        };
        let red = mixed(reds[i], known, looks[i]);
        let green = mixed(greens[i], known >> 5, looks[i] >> 8);
        let blue = mixed(blues[i], known >> 10, looks[i] >> 16);
        let parts = (red & 31 | (green & 31) << 5 | (blue & 31) << 10) as u16 | COLORED;
        reds[i] = if is_near { (red >> 5) as u8 } else { reds[i] };
        greens[i] = if is_near { (green >> 5) as u8 } else { greens[i] };
        blues[i] = if is_near { (blue >> 5) as u8 } else { blues[i] };
        fractions[i] = if is_near { parts } else { known };
    }
}
