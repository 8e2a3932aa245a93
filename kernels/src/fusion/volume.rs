//! TSDF volume.

use super::block_order::block_of_key;
use super::block_storage::BlockStorage;
use super::distance_field::{BLOCK_VOXELS, DistanceField, VoxelSample};
use super::frame_view::FrameView;
use super::integration::{IntegrateBlock, ProjectedFrame, instruction_variants, integrate};
use super::surface_extraction::BlockBox;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Volume that grows by the blocks that frames touch.
#[derive(Debug)]
pub struct TsdfVolume {
    voxel_size: f64,
    /// Truncation distance in voxels.
    truncation: f32,
    blocks: BlockStorage,
    add: IntegrateBlock,
}

impl TsdfVolume {
    /// Create an empty volume of at most `most` blocks. Lengths are in metres, the truncation along the
    /// surface normal.
    pub fn new(voxel_size: f64, truncation: f64, is_colored: bool, most: usize) -> Self {
        Self {
            voxel_size,
            truncation: (truncation / voxel_size) as f32,
            blocks: BlockStorage::new(is_colored, most),
            add: instruction_variants()[0].1,
        }
    }

    /// Use another instruction-set variant of the integration.
    pub fn with_variant(self, add: IntegrateBlock) -> Self {
        Self { add, ..self }
    }

    /// Return the block storage.
    pub fn blocks(&self) -> &BlockStorage {
        &self.blocks
    }

    /// Integrate a frame into the blocks with the given keys.
    ///
    /// # Errors
    /// [`KernelError::TooManyBlocks`]: nothing is integrated. As [`Progress::check`]: everything or nothing
    /// is integrated.
    pub fn integrate(
        &mut self,
        keys: &[u64],
        view: &FrameView,
        threads: usize,
        progress: &Progress<'_>,
    ) -> Result<(), KernelError> {
        let slots = self.blocks.get_or_create(keys, progress)?;
        let frame = ProjectedFrame::new(view, self.voxel_size);
        integrate(&frame, self.blocks.borrow_mut(&slots), self.add, threads);
        progress.check()
    }

    /// Compute a histogram of observation counts, over voxels within half a truncation of the surface in a
    /// box of blocks. Every seventh voxel is sampled.
    pub fn observation_histogram(&self, within: Option<BlockBox>) -> [u64; 256] {
        let mut counts = [0; 256];
        for slot in 0..self.blocks.count() {
            if !within.is_none_or(|within| within.contains(self.block_coordinates(slot))) {
                continue;
            }
            let distances = self.blocks.distances(slot);
            for voxel in (0..BLOCK_VOXELS).step_by(7) {
                if distances.distance_of(voxel, 1).abs() < 0.5 {
                    counts[usize::from(distances.frames(voxel))] += 1;
                }
            }
        }
        counts
    }
}

/// Clamp a minimum frame count to 1–255, because counts saturate at 255.
fn clamp_frame_count(least: u32) -> u8 {
    least.clamp(1, 255) as u8
}

impl DistanceField for TsdfVolume {
    fn block_count(&self) -> usize {
        self.blocks.count()
    }

    fn block_coordinates(&self, slot: usize) -> [i32; 3] {
        block_of_key(self.blocks.key(slot))
    }

    /// Distances in voxels.
    fn distances(&self, slot: usize, least: u32, into: &mut [f32; BLOCK_VOXELS]) {
        let (of, least) = (self.blocks.distances(slot), clamp_frame_count(least));
        let (sums, weights) = (of.sum.as_flattened(), of.weight.as_flattened());
        let known = weights.iter().zip(of.frames.as_flattened());
        for ((into, sum), (&weight, &frames)) in into.iter_mut().zip(sums).zip(known) {
            let distance = sum / f32::from(weight) * self.truncation;
            *into = if (weight > 0) & (frames >= least) { distance } else { f32::NAN };
        }
    }

    fn distance(&self, slot: usize, voxel: usize, least: u32) -> f32 {
        self.blocks.distances(slot).distance_of(voxel, clamp_frame_count(least)) * self.truncation
    }

    fn sample(&self, slot: usize, voxel: usize) -> VoxelSample {
        VoxelSample {
            color: self.blocks.colors(slot).map_or([0.0; 3], |colors| colors.color_of(voxel)),
            observation_count: self.blocks.distances(slot).frames(voxel).into(),
            cosine: 0.0,
        }
    }
}

#[cfg(test)]
mod tests;
