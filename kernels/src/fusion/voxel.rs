//! What is kept of a voxel: 12 bytes, or 7 without colour, in one array for each part.
//!
//! | part | bytes | what |
//! | --- | --- | --- |
//! | sum | 4 | of weight × distance, in truncations |
//! | weight | 2 | sum of weights; where it would overflow, sum and weight are halved, and older frames count less |
//! | frames | 1 | how many frames saw it, 255 for more |
//! | colour | 5 | mean of red, green and blue, eight bits and five of fraction each |
//!
//! A sum loses nothing when thousands of frames are added, where a mean in few bits would no longer move: single precision
//! is exact to 2⁻²⁴ of the largest sum of weights. Colours are a mean, whose last levels some dozen frames tell.

use super::field::{SIDE, VOXELS};

/// Voxels of a slice: of one z.
pub const SLICE: usize = SIDE * SIDE;

/// The weight of a frame that weighs 1.
pub const UNIT: f32 = 32.0;
/// The heaviest a frame can be.
pub const HEAVIEST: f32 = 255.0;
/// The colour is the mean of about so many typical frames, the latest.
pub const COLOR_FRAMES: f32 = 64.0;
/// Fractions of a level of colour.
pub const FRACTIONS: f32 = 32.0;
/// Of a voxel that has a colour, in `fractions`.
pub const COLORED: u16 = 1 << 15;

/// Distances of a block, slice by slice, x fastest.
#[derive(Clone, Debug)]
pub struct Distances {
    pub sum: [[f32; SLICE]; SIDE],
    pub weight: [[u16; SLICE]; SIDE],
    pub frames: [[u8; SLICE]; SIDE],
}

/// Colours of a block.
#[derive(Clone, Debug)]
pub struct Colors {
    /// Fractions of red, green and blue in five bits each, from below, and [`COLORED`].
    pub fractions: [[u16; SLICE]; SIDE],
    pub levels: [[[u8; SLICE]; SIDE]; 3],
}

impl Distances {
    pub const NONE: Self =
        Self { sum: [[0.0; SLICE]; SIDE], weight: [[0; SLICE]; SIDE], frames: [[0; SLICE]; SIDE] };

    /// Distance of a voxel in truncations, NaN where too few frames have seen it.
    #[inline]
    pub fn of(&self, voxel: usize, least: u8) -> f32 {
        let weight = self.weight.as_flattened()[voxel];
        let is_known = weight > 0 && self.frames(voxel) >= least;
        if is_known { self.sum.as_flattened()[voxel] / f32::from(weight) } else { f32::NAN }
    }

    /// How many frames saw a voxel, 255 for more.
    #[inline]
    pub fn frames(&self, voxel: usize) -> u8 {
        self.frames.as_flattened()[voxel]
    }
}

impl Colors {
    pub const NONE: Self = Self { fractions: [[0; SLICE]; SIDE], levels: [[[0; SLICE]; SIDE]; 3] };

    /// Levels of a voxel, 0 to 255; black where none was seen.
    #[inline]
    pub fn of(&self, voxel: usize) -> [f32; 3] {
        let fractions = self.fractions.as_flattened()[voxel];
        std::array::from_fn(|c| {
            let fraction = fractions >> (5 * c) & 31;
            f32::from(self.levels[c].as_flattened()[voxel]) + f32::from(fraction) / FRACTIONS
        })
    }
}

/// Bytes of a block.
pub const fn block_bytes(color: bool) -> usize {
    size_of::<Distances>() + if color { size_of::<Colors>() } else { 0 }
}

const _: () = assert!(SIDE == 8 && block_bytes(true) == 12 * VOXELS && block_bytes(false) == 7 * VOXELS);
