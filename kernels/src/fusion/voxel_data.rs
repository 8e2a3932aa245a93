//! Voxel data: 12 bytes per voxel, or 7 without colour, as one array per component.
//!
//! | component | bytes | content |
//! | --- | --- | --- |
//! | sum | 4 | sum of weight × distance, in truncations |
//! | weight | 2 | sum of weights; before an overflow, sum and weight are halved, so that older frames count less |
//! | frames | 1 | number of frames that observed the voxel, saturated at 255 |
//! | colour | 5 | mean RGB, eight integer and five fractional bits per channel |
//!
//! Unlike a low-precision mean, a sum still changes after thousands of frames: single precision is exact to
//! 2⁻²⁴ of the largest sum of weights. Colours are running means of the latest frames.

use super::distance_field::{BLOCK_SIDE, BLOCK_VOXELS};

/// Voxels of a slice (constant z).
pub const SLICE_VOXELS: usize = BLOCK_SIDE * BLOCK_SIDE;

/// Stored weight of a frame with weight 1.
pub const WEIGHT_UNIT: f32 = 32.0;
/// Maximum stored weight of a frame.
pub const MAX_WEIGHT: f32 = 255.0;
/// The colour is the running mean of about this number of typical frames, the latest ones.
pub const COLOR_FRAMES: f32 = 64.0;
/// Fractional steps per colour level.
pub const COLOR_FRACTIONS: f32 = 32.0;
/// Bit in `fractions` that is set once a voxel has a colour.
pub const HAS_COLOR: u16 = 1 << 15;

/// Distances of a block, slice by slice, x fastest.
#[derive(Clone, Debug)]
pub struct BlockDistances {
    pub sum: [[f32; SLICE_VOXELS]; BLOCK_SIDE],
    pub weight: [[u16; SLICE_VOXELS]; BLOCK_SIDE],
    pub frames: [[u8; SLICE_VOXELS]; BLOCK_SIDE],
}

/// Colours of a block.
#[derive(Clone, Debug)]
pub struct BlockColors {
    /// Fractional parts of red, green and blue, five bits each from the lowest bit, and [`HAS_COLOR`].
    pub fractions: [[u16; SLICE_VOXELS]; BLOCK_SIDE],
    pub levels: [[[u8; SLICE_VOXELS]; BLOCK_SIDE]; 3],
}

impl BlockDistances {
    pub const NONE: Self = Self {
        sum: [[0.0; SLICE_VOXELS]; BLOCK_SIDE],
        weight: [[0; SLICE_VOXELS]; BLOCK_SIDE],
        frames: [[0; SLICE_VOXELS]; BLOCK_SIDE],
    };

    /// Return the distance of a voxel in truncations; NaN if fewer than `least` frames observed it.
    #[inline]
    pub fn distance_of(&self, voxel: usize, least: u8) -> f32 {
        let weight = self.weight.as_flattened()[voxel];
        let is_known = weight > 0 && self.frames(voxel) >= least;
        if is_known { self.sum.as_flattened()[voxel] / f32::from(weight) } else { f32::NAN }
    }

    /// Return the number of frames that observed a voxel, saturated at 255.
    #[inline]
    pub fn frames(&self, voxel: usize) -> u8 {
        self.frames.as_flattened()[voxel]
    }
}

impl BlockColors {
    pub const NONE: Self =
        Self { fractions: [[0; SLICE_VOXELS]; BLOCK_SIDE], levels: [[[0; SLICE_VOXELS]; BLOCK_SIDE]; 3] };

    /// Return the RGB levels of a voxel, 0 to 255; black if it has no colour.
    #[inline]
    pub fn color_of(&self, voxel: usize) -> [f32; 3] {
        let fractions = self.fractions.as_flattened()[voxel];
        std::array::from_fn(|c| {
            let fraction = fractions >> (5 * c) & 31;
            f32::from(self.levels[c].as_flattened()[voxel]) + f32::from(fraction) / COLOR_FRACTIONS
        })
    }
}

/// Compute the bytes of a block.
pub const fn block_bytes(color: bool) -> usize {
    size_of::<BlockDistances>() + if color { size_of::<BlockColors>() } else { 0 }
}

const _: () = assert!(
    BLOCK_SIDE == 8 && block_bytes(true) == 12 * BLOCK_VOXELS && block_bytes(false) == 7 * BLOCK_VOXELS
);
