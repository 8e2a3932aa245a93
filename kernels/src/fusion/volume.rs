//! The field that frames are added to.

use super::blocks::Blocks;
use super::field::{Field, Sample, VOXELS};
use super::integrate::{Add, Frame, integrate, versions};
use super::order::block;
use super::view::View;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// A field that grows by the blocks that frames touch.
#[derive(Debug)]
pub struct Volume {
    voxel_size: f64,
    /// In voxels.
    truncation: f32,
    blocks: Blocks,
    add: Add,
}

impl Volume {
    /// Lengths are metres, the truncation along the surface's normal; there are never more than `most` blocks.
    pub fn new(voxel_size: f64, truncation: f64, is_colored: bool, most: usize) -> Self {
        Self {
            voxel_size,
            truncation: (truncation / voxel_size) as f32,
            blocks: Blocks::new(is_colored, most),
            add: versions()[0].1,
        }
    }

    pub fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// Add a frame to the blocks that have some keys.
    ///
    /// # Errors
    /// [`KernelError::TooManyBlocks`]: then nothing is added. As [`Progress::check`]: then all or nothing is.
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

    /// How many frames saw the median voxel within half a truncation of the surface; 0 if there is none. Every seventh voxel
    /// of a block is looked at.
    pub fn typical_frames(&self) -> f64 {
        let mut counts = [0usize; 256];
        for slot in 0..self.blocks.count() {
            let distances = self.blocks.distances(slot);
            for voxel in (0..VOXELS).step_by(7) {
                if distances.of(voxel, 1).abs() < 0.5 {
                    counts[usize::from(distances.frames(voxel))] += 1;
                }
            }
        }
        median(&counts)
    }
}

/// Median of numbers of which it is known how often each is there; the mean of both in the middle of an even number.
fn median(counts: &[usize; 256]) -> f64 {
    let all: usize = counts.iter().sum();
    let at = |rank: usize| {
        let mut passed = 0;
        let is_before = |count: &&usize| {
            passed += **count;
            passed <= rank
        };
        counts.iter().take_while(is_before).count()
    };
    if all == 0 { 0.0 } else { (at((all - 1) / 2) + at(all / 2)) as f64 / 2.0 }
}

/// How many frames must have seen a voxel: they are counted no farther than 255.
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

    /// In voxels.
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
