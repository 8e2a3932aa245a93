//! TSDF volume.

use super::blocks::Blocks;
use super::field::{Field, Sample, VOXELS};
use super::integrate::{Add, Frame, integrate, versions};
use super::order::block;
use super::surface::BlockBox;
use super::view::View;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Volume that grows by the blocks that frames touch.
#[derive(Debug)]
pub struct Volume {
    voxel_size: f64,
    /// Truncation distance in voxels.
    truncation: f32,
    blocks: Blocks,
    add: Add,
}

impl Volume {
    /// Create an empty volume of at most `most` blocks. Lengths are in metres, the truncation along the
    /// surface normal.
    pub fn new(voxel_size: f64, truncation: f64, is_colored: bool, most: usize) -> Self {
        Self {
            voxel_size,
            truncation: (truncation / voxel_size) as f32,
            blocks: Blocks::new(is_colored, most),
            add: versions()[0].1,
        }
    }

    /// Use another instruction-set variant of the integration.
    pub fn using(self, add: Add) -> Self {
        Self { add, ..self }
    }

    /// Return the block storage.
    pub fn blocks(&self) -> &Blocks {
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
        view: &View,
        threads: usize,
        progress: &Progress<'_>,
    ) -> Result<(), KernelError> {
        let slots = self.blocks.claim(keys, progress)?;
        let frame = Frame::new(view, self.voxel_size);
        integrate(&frame, self.blocks.written(&slots), self.add, threads);
        progress.check()
    }

    /// Compute a histogram of observation counts, over voxels within half a truncation of the surface in a
    /// box of blocks. Every seventh voxel is sampled.
    pub fn frame_counts(&self, within: Option<BlockBox>) -> [u64; 256] {
        let mut counts = [0; 256];
        for slot in 0..self.blocks.count() {
            if !within.is_none_or(|within| within.contains(self.block(slot))) {
                continue;
            }
            let distances = self.blocks.distances(slot);
            for voxel in (0..VOXELS).step_by(7) {
                if distances.of(voxel, 1).abs() < 0.5 {
                    counts[usize::from(distances.frames(voxel))] += 1;
                }
            }
        }
        counts
    }
}

/// Clamp a minimum frame count to 1–255, because counts saturate at 255.
fn bounded(least: u32) -> u8 {
    least.clamp(1, 255) as u8
}

impl Field for Volume {
    fn count(&self) -> usize {
        self.blocks.count()
    }

    fn block(&self, slot: usize) -> [i32; 3] {
        block(self.blocks.key(slot))
    }

    /// Distances in voxels.
    fn distances(&self, slot: usize, least: u32, into: &mut [f32; VOXELS]) {
        let (of, least) = (self.blocks.distances(slot), bounded(least));
        let (sums, weights) = (of.sum.as_flattened(), of.weight.as_flattened());
        let known = weights.iter().zip(of.frames.as_flattened());
        for ((into, sum), (&weight, &frames)) in into.iter_mut().zip(sums).zip(known) {
            let distance = sum / f32::from(weight) * self.truncation;
            *into = if (weight > 0) & (frames >= least) { distance } else { f32::NAN };
        }
    }

    fn distance(&self, slot: usize, voxel: usize, least: u32) -> f32 {
        self.blocks.distances(slot).of(voxel, bounded(least)) * self.truncation
    }

    fn sample(&self, slot: usize, voxel: usize) -> Sample {
        Sample {
            color: self.blocks.colors(slot).map_or([0.0; 3], |colors| colors.of(voxel)),
            frames: self.blocks.distances(slot).frames(voxel).into(),
            cosine: 0.0,
        }
    }
}

#[cfg(test)]
mod tests;
