//! Interface of a signed distance field for surface extraction.

/// Voxels along an edge of a block.
pub const BLOCK_SIDE: usize = 8;
/// Voxels of a block.
pub const BLOCK_VOXELS: usize = BLOCK_SIDE * BLOCK_SIDE * BLOCK_SIDE;

/// Signed distance field stored in blocks of 8³ voxels. Voxel indices increase along x first, then y, then z.
pub trait DistanceField: Sync {
    /// Return the number of blocks.
    fn block_count(&self) -> usize;
    /// Return the coordinates of a block, in blocks.
    fn block_coordinates(&self, slot: usize) -> [i32; 3];
    /// Write the signed distances of a block's voxels into `into`; NaN for voxels observed by fewer than
    /// `least` frames.
    fn distances(&self, slot: usize, least: u32, into: &mut [f32; BLOCK_VOXELS]);
    /// Return the signed distance of one voxel, NaN as in [`DistanceField::distances`].
    fn distance(&self, slot: usize, voxel: usize, least: u32) -> f32;
    /// Return the colour and observation data of one voxel.
    fn sample(&self, slot: usize, voxel: usize) -> VoxelSample;
}

/// Colour and observation data of a surface point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VoxelSample {
    /// RGB, 0 to 255.
    pub color: [f32; 3],
    /// Number of frames that observed the point.
    pub observation_count: f32,
    /// Mean cosine of the viewing angle; 0 if the field does not store it.
    pub cosine: f32,
}

impl VoxelSample {
    /// Interpolate linearly between two samples.
    pub fn interpolate(a: Self, b: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self {
            color: std::array::from_fn(|k| mix(a.color[k], b.color[k])),
            observation_count: mix(a.observation_count, b.observation_count),
            cosine: mix(a.cosine, b.cosine),
        }
    }
}
