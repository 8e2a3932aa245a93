//! A signed distance field, as its surface is taken from it.

/// Voxels along an edge of a block.
pub const SIDE: usize = 8;
/// Voxels of a block.
pub const VOXELS: usize = SIDE * SIDE * SIDE;

/// A field of blocks of 8³ voxels. Voxels are counted x first, then y, then z.
pub trait Field: Sync {
    /// How many blocks there are.
    fn count(&self) -> usize;
    /// Coordinates of a block, in blocks.
    fn block(&self, slot: usize) -> [i32; 3];
    /// Signed distances of a block's voxels, NaN where fewer frames than `least` have seen one.
    fn distances(&self, slot: usize, least: u32, into: &mut [f32; VOXELS]);
    /// The same of one voxel.
    fn distance(&self, slot: usize, voxel: usize, least: u32) -> f32;
    /// What else is known of one voxel.
    fn sample(&self, slot: usize, voxel: usize) -> Sample;
}

/// What is known of a place beside its distance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// 0 to 255.
    pub color: [f32; 3],
    /// How many have seen it.
    pub frames: f32,
    /// Mean cosine of the angle they saw it at; 0 where that is not kept.
    pub cosine: f32,
}

impl Sample {
    pub fn between(a: Self, b: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self {
            color: std::array::from_fn(|k| mix(a.color[k], b.color[k])),
            frames: mix(a.frames, b.frames),
            cosine: mix(a.cosine, b.cosine),
        }
    }
}
