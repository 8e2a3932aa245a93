//! Which blocks a frame has something to say of.
//!
//! Those that hold a place of the surface, or one half a truncation before or behind it along its normal. Pixels are looked
//! at that are close enough on the surface; so whether a block is touched depends on the frame alone, and not on which
//! blocks there are or are asked for.

use super::field::SIDE;
use super::order::{REACH, block, key};
use super::surface::BlockBox;
use super::view::Camera;
use crate::base::errors::KernelError;

/// Pixels looked at are nearer to each other on the surface than this, in blocks.
const SPACING: f32 = 0.25;
/// Of pixels along rows and columns, every so many at least are looked at.
const COARSEST: usize = 8;

/// A surface that a camera measured, image by image, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Metres, not positive where missing.
    pub depth: &'a [f32],
    /// Normals in camera axes, as long as `obliqueness`.
    pub normal: [&'a [f32]; 3],
    pub obliqueness: &'a [f32],
    /// The pixels whose surface is to be in the field.
    pub wanted: &'a [bool],
}

/// Keys of the blocks that a surface touches, sorted; with `within`, of those there alone.
///
/// # Errors
/// [`KernelError::BeyondReach`] if a place is farther from the field's origin than blocks have numbers.
pub fn touched(
    camera: &Camera,
    surface: Surface<'_>,
    voxel_size: f64,
    truncation: f32,
    within: Option<BlockBox>,
) -> Result<Vec<u64>, KernelError> {
    let side = voxel_size * SIDE as f64;
    let spacing = SPACING * side as f32;
    let to_field = ToBlocks::new(camera, side);
    let pixel = (1.0 / camera.focal[0].min(camera.focal[1])) as f32;
    let mut keys = vec![];
    // The last block on each side of the surface: the next pixel is mostly in the same.
    let mut last = [[i32::MIN; 3]; 3];
    for y in 0..camera.height {
        let down = ((y as f64 - camera.centre[1]) / camera.focal[1]) as f32;
        // Rows that no coarser grid has are looked at by the finest alone.
        let coarsest = 1 << (y.trailing_zeros().min(COARSEST.ilog2()));
        for x in 0..camera.width {
            let i = y * camera.width + x;
            let z = surface.depth[i];
            if !surface.wanted[i] || !(z > 0.0) {
                continue;
            }
            let step = coarsest.min(1 << x.trailing_zeros().min(COARSEST.ilog2()));
            let oblique = surface.obliqueness[i];
            let apart = z * oblique * pixel;
            // The widest grid that is close enough here must have this pixel.
            if step < COARSEST && apart * (2 * step) as f32 <= spacing {
                continue;
            }
            let across = ((x as f64 - camera.centre[0]) / camera.focal[0]) as f32;
            let on = [across * z, down * z, z];
            let offset = truncation / 2.0 / oblique;
            for (way, last) in [0.0, -offset, offset].into_iter().zip(&mut last) {
                let place = to_field.of([0, 1, 2].map(|k| on[k] + way * surface.normal[k][i]))?;
                if place != *last {
                    *last = place;
                    keys.push(key(place));
                }
            }
        }
    }
    keys.sort_unstable();
    keys.dedup();
    if let Some(within) = within {
        keys.retain(|&key| within.contains(block(key)));
    }
    Ok(keys)
}

/// From camera axes to blocks of the field.
struct ToBlocks([[f32; 4]; 3]);

impl ToBlocks {
    fn new(camera: &Camera, side: f64) -> Self {
        Self(camera.pose.map(|row| row.map(|x| (x / side) as f32)))
    }

    #[inline(always)]
    fn of(&self, p: [f32; 3]) -> Result<[i32; 3], KernelError> {
        let at = self.0.map(|row| (row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]).floor());
        if at.iter().all(|c| c.abs() < REACH as f32) {
            Ok(at.map(|c| c as i32))
        } else {
            Err(KernelError::BeyondReach { blocks: REACH as usize })
        }
    }
}
