//! Blocks that a frame must be integrated into.
//!
//! A block is touched if it contains a surface point, or a point half a truncation in front of or behind the
//! surface along its normal. Pixels are sampled so that samples are dense enough on the surface. The touched
//! blocks depend on the frame only, not on existing or requested blocks.

use super::block_order::{MAX_COORDINATE, block_key, block_of_key};
use super::distance_field::BLOCK_SIDE;
use super::frame_view::FusionCamera;
use super::surface_extraction::BlockBox;
use crate::base::by_processor::by_processor;
use crate::base::errors::KernelError;

/// Maximum distance of sampled pixels on the surface, in blocks.
const MAX_SAMPLE_SPACING: f32 = 0.25;
/// Cell side in pixels; at least one pixel per cell is sampled.
const CELL_PIXELS: usize = 8;

/// Number of remembered blocks. Consecutive pixels mostly hit the same blocks, so this removes nearly all
/// duplicates.
const CACHE_SLOTS: usize = 1 << 12;

/// Points processed together.
const BATCH_POINTS: usize = 64;

/// Surface measured by a camera, row by row.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredSurface<'a> {
    /// Depth in metres, not positive where missing.
    pub depth: &'a [f32],
    /// Normals in camera axes, with length `obliqueness`.
    pub normal: [&'a [f32]; 3],
    pub obliqueness: &'a [f32],
    /// Mask of the pixels to fuse.
    pub wanted: &'a [bool],
}

/// Find the sorted keys of the blocks that a surface touches; only those in the box `within`, if given.
///
/// # Errors
/// [`KernelError::OutOfBlockRange`] if a point is too far from the origin of the volume for block coordinates.
pub fn collect_touched_blocks(
    camera: &FusionCamera,
    surface: MeasuredSurface<'_>,
    voxel_size: f64,
    truncation: f32,
    within: Option<BlockBox>,
) -> Result<Vec<u64>, KernelError> {
    let side = voxel_size * BLOCK_SIDE as f64;
    let finest = (MAX_SAMPLE_SPACING * side as f32) * camera.focal[0].min(camera.focal[1]) as f32;
    let sights = [0, 1].map(|axis| {
        let count = [camera.width, camera.height][axis];
        (0..count).map(|k| ((k as f64 - camera.centre[axis]) / camera.focal[axis]) as f32).collect::<Vec<_>>()
    });
    let to_blocks = camera.pose.map(|row| row.map(|x| (x / side) as f32));
    let mut found = BlockKeys { keys: vec![], recent: vec![[i32::MIN; 3]; CACHE_SLOTS] };
    let mut batch = PointBatch::default();
    let mut widest = vec![0f32; camera.width.div_ceil(CELL_PIXELS)];
    for top in (0..camera.height).step_by(CELL_PIXELS) {
        let rows = top..camera.height.min(top + CELL_PIXELS);
        widest.fill(0.0);
        for y in rows.clone() {
            let own = y * camera.width..(y + 1) * camera.width;
            let cells = surface.depth[own.clone()]
                .chunks(CELL_PIXELS)
                .zip(surface.obliqueness[own].chunks(CELL_PIXELS));
            for (widest, (depth, oblique)) in widest.iter_mut().zip(cells) {
                *widest = depth.iter().zip(oblique).fold(*widest, |most, (z, o)| most.max(z * o));
            }
        }
        for (cell, &widest) in widest.iter().enumerate() {
            if widest <= 0.0 {
                continue;
            }
            let step = sampling_step(finest / widest);
            let columns = cell * CELL_PIXELS..camera.width.min((cell + 1) * CELL_PIXELS);
            for y in rows.clone().step_by(step) {
                for x in columns.clone().step_by(step) {
                    let i = y * camera.width + x;
                    let z = surface.depth[i];
                    if !surface.wanted[i] || z.is_nan() || z <= 0.0 {
                        continue;
                    }
                    let offset = truncation / 2.0 / surface.obliqueness[i];
                    let on = [sights[0][x] * z, sights[1][y] * z, z];
                    let [p, q, r] = surface.normal;
                    batch.push(on, [offset * p[i], offset * q[i], offset * r[i]]);
                    if batch.count == BATCH_POINTS {
                        found.add_batch(&mut batch, &to_blocks)?;
                    }
                }
            }
        }
    }
    found.add_batch(&mut batch, &to_blocks)?;
    let mut keys = found.keys;
    keys.sort_unstable();
    keys.dedup();
    if let Some(within) = within {
        keys.retain(|&key| within.contains(block_of_key(key)));
    }
    Ok(keys)
}

/// Compute the cache slot of a block.
#[inline(always)]
fn cache_slot([x, y, z]: [i32; 3]) -> usize {
    (x ^ y << 4 ^ z << 8) as usize % CACHE_SLOTS
}

/// Compute the sampling step in pixels for a maximum sample distance of `apart` pixels: a power of two, at
/// most one cell.
fn sampling_step(apart: f32) -> usize {
    let mut step = CELL_PIXELS;
    while step > 1 && step as f32 > apart {
        step /= 2;
    }
    step
}

/// Surface points in camera axes, with their offsets of half a truncation along the normal.
struct PointBatch {
    on: [[f32; BATCH_POINTS]; 3],
    offset: [[f32; BATCH_POINTS]; 3],
    count: usize,
}

impl Default for PointBatch {
    fn default() -> Self {
        Self { on: [[0.0; BATCH_POINTS]; 3], offset: [[0.0; BATCH_POINTS]; 3], count: 0 }
    }
}

impl PointBatch {
    fn push(&mut self, on: [f32; 3], offset: [f32; 3]) {
        for axis in 0..3 {
            self.on[axis][self.count] = on[axis];
            self.offset[axis][self.count] = offset[axis];
        }
        self.count += 1;
    }
}

/// Collected block keys, nearly without duplicates.
struct BlockKeys {
    keys: Vec<u64>,
    recent: Vec<[i32; 3]>,
}

impl BlockKeys {
    /// Add the blocks of a batch and empty it.
    fn add_batch(&mut self, batch: &mut PointBatch, to_blocks: &Affine) -> Result<(), KernelError> {
        for way in [0.0, -1.0, 1.0] {
            let mut places = [[0; BATCH_POINTS]; 3];
            if !blocks_of_batch(batch, to_blocks, way, &mut places) {
                return Err(KernelError::OutOfBlockRange { blocks: MAX_COORDINATE as usize });
            }
            let [x, y, z] = &places;
            for ((&x, &y), &z) in x.iter().zip(y).zip(z).take(batch.count) {
                let place = [x, y, z];
                let recent = &mut self.recent[cache_slot(place)];
                if *recent != place {
                    *recent = place;
                    self.keys.push(block_key(place));
                }
            }
        }
        batch.count = 0;
        Ok(())
    }
}

/// Affine map from camera axes to block coordinates.
type Affine = [[f32; 4]; 3];

by_processor! {
    /// Compute the blocks of points moved along the normal; return false if one is out of range.
    fn blocks_of_batch(batch: &PointBatch, to_blocks: &Affine, way: f32, places: &mut [[i32; BATCH_POINTS]; 3]) -> bool = blocks_of
}

#[inline(always)]
fn blocks_of(
    batch: &PointBatch,
    to_blocks: &Affine,
    way: f32,
    places: &mut [[i32; BATCH_POINTS]; 3],
) -> bool {
    let mut is_near = true;
    for (row, places) in to_blocks.iter().zip(places) {
        for (i, place) in places.iter_mut().enumerate() {
            let moved = |axis: usize| batch.on[axis][i] + way * batch.offset[axis][i];
            let at = row[0] * moved(0) + row[1] * moved(1) + row[2] * moved(2) + row[3];
            let most = MAX_COORDINATE as f32 - 1.0;
            // False for NaN.
            let is_one = (at > -most) & (at < most);
            // Values remaining from earlier batches are ignored.
            is_near &= is_one | (i >= batch.count);
            // SAFETY: the value is a number with an absolute value below 2³¹.
            let cut: i32 = unsafe { if is_one { at } else { 0.0 }.to_int_unchecked() };
            // Round down where the conversion has truncated towards zero.
            *place = cut - i32::from(at < cut as f32);
        }
    }
    is_near
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_cut_off_downwards_and_wide_instructions_do_the_same() {
        let mut batch = PointBatch::default();
        for i in 0..BATCH_POINTS {
            batch.push([i as f32 * 0.37 - 9.0, 1.5, 4.0], [0.0, 0.25, 0.0]);
        }
        let turn = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, -2.0], [0.3, 0.0, 0.5, 0.01]];
        let run = |find: fn(&PointBatch, &Affine, f32, &mut [[i32; BATCH_POINTS]; 3]) -> bool| {
            let mut places = [[0; BATCH_POINTS]; 3];
            (find(&batch, &turn, -1.0, &mut places), places)
        };
        let (is_near, places) = run(blocks_of_batch);
        assert!(is_near);
        for (i, &x) in places[0].iter().enumerate() {
            assert_eq!((x, places[1][i]), ((i as f32 * 0.37 - 9.0).floor() as i32, -1));
        }
        assert_eq!((is_near, places), run(blocks_of));
    }

    #[test]
    fn grids_are_as_fine_as_is_asked_for() {
        assert_eq!([100.0, 8.0, 7.9, 3.0, 2.0, 0.1].map(sampling_step), [8, 8, 4, 2, 2, 1]);
    }
}
