//! Storage of voxel blocks: slots, and a hash map from block key to slot.
//!
//! Slots are assigned in order of arrival; the blocks of one frame arrive in Z-order. Memory is allocated in
//! pages that never move, so growth copies nothing.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use super::block_order::block_of_key;
use super::voxel_data::{BlockColors, BlockDistances, block_bytes};
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Blocks per page.
const BLOCKS_PER_PAGE: usize = 64;
/// Fibonacci hashing: one multiplication spreads the keys evenly.
#[derive(Clone, Copy, Debug, Default)]
struct FibonacciHasher(u64);

impl Hasher for FibonacciHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }

    #[inline]
    fn write_u64(&mut self, key: u64) {
        let mixed = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ mixed >> 32;
    }
}

/// Blocks that are contiguous in memory.
#[derive(Debug)]
struct BlockPage {
    distances: Vec<BlockDistances>,
    colors: Vec<BlockColors>,
}

/// All blocks of a volume.
#[derive(Debug)]
pub struct BlockStorage {
    slots: HashMap<u64, u32, BuildHasherDefault<FibonacciHasher>>,
    keys: Vec<u64>,
    pages: Vec<BlockPage>,
    is_colored: bool,
    max_count: usize,
}

/// Mutable access to a block.
pub struct BlockMut<'a> {
    pub block: [i32; 3],
    pub distances: &'a mut BlockDistances,
    pub colors: Option<&'a mut BlockColors>,
}

impl BlockStorage {
    /// Create an empty storage that never holds more than `max_count` blocks.
    pub fn new(is_colored: bool, most: usize) -> Self {
        let most = most.min(u32::MAX as usize);
        Self { slots: HashMap::default(), keys: vec![], pages: vec![], is_colored, max_count: most }
    }

    /// Return the number of blocks.
    pub fn count(&self) -> usize {
        self.keys.len()
    }

    /// Return true if voxels have colours.
    pub fn is_colored(&self) -> bool {
        self.is_colored
    }

    /// Return the memory of all pages in bytes.
    pub fn bytes(&self) -> usize {
        self.pages.len() * BLOCKS_PER_PAGE * block_bytes(self.is_colored)
    }

    /// Return the Z-order key of the block in a slot.
    pub fn key(&self, slot: usize) -> u64 {
        self.keys[slot]
    }

    /// Return the distances of the block in a slot.
    pub fn distances(&self, slot: usize) -> &BlockDistances {
        &self.pages[slot / BLOCKS_PER_PAGE].distances[slot % BLOCKS_PER_PAGE]
    }

    /// Return the colours of the block in a slot; None if voxels have no colours.
    pub fn colors(&self, slot: usize) -> Option<&BlockColors> {
        self.pages[slot / BLOCKS_PER_PAGE].colors.get(slot % BLOCKS_PER_PAGE)
    }

    /// Return the sorted slots of blocks; create empty blocks where they are missing.
    ///
    /// # Errors
    /// [`KernelError::TooManyBlocks`] if the block limit would be exceeded; then no block is created. As
    /// [`Progress::check`].
    pub fn get_or_create(&mut self, keys: &[u64], progress: &Progress<'_>) -> Result<Vec<u32>, KernelError> {
        let missing = keys.iter().filter(|key| !self.slots.contains_key(key)).count();
        let wanted = self.count() + missing;
        if wanted > self.max_count {
            return Err(KernelError::TooManyBlocks { wanted, limit: self.max_count });
        }
        // Check after every page, because the memory reserve covers only a few pages.
        while self.pages.len() * BLOCKS_PER_PAGE < wanted {
            let colors = if self.is_colored { vec![BlockColors::NONE; BLOCKS_PER_PAGE] } else { vec![] };
            self.pages.push(BlockPage { distances: vec![BlockDistances::NONE; BLOCKS_PER_PAGE], colors });
            progress.check()?;
        }
        let mut slots = Vec::with_capacity(keys.len());
        for &key in keys {
            let next = self.keys.len() as u32;
            let slot = *self.slots.entry(key).or_insert(next);
            if slot == next {
                self.keys.push(key);
            }
            slots.push(slot);
        }
        slots.sort_unstable();
        slots.dedup();
        progress.check()?;
        Ok(slots)
    }

    /// Borrow the blocks of slots mutably. `slots` must be sorted and unique.
    pub fn borrow_mut<'a>(&'a mut self, slots: &[u32]) -> Vec<BlockMut<'a>> {
        let mut found = Vec::with_capacity(slots.len());
        let mut slots = slots.iter().map(|&slot| slot as usize).peekable();
        for (number, page) in self.pages.iter_mut().enumerate() {
            let (mut distances, mut colors) = (page.distances.iter_mut(), page.colors.iter_mut());
            // Elements of the page that the iterators have consumed, as a slot index.
            let mut passed = number * BLOCKS_PER_PAGE;
            while let Some(slot) = slots.next_if(|&slot| slot < (number + 1) * BLOCKS_PER_PAGE) {
                let (skipped, colors) = (slot - passed, colors.nth(slot - passed));
                let Some(distances) = distances.nth(skipped) else { break };
                found.push(BlockMut { block: block_of_key(self.keys[slot]), distances, colors });
                passed = slot + 1;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::block_order::block_key;
    use super::*;
    use crate::base::progress::RunControl;

    #[test]
    fn blocks_keep_their_slots_and_are_written_one_by_one() {
        let control = RunControl::default();
        let progress = Progress::new(&control);
        let mut blocks = BlockStorage::new(true, 300);
        let keys: Vec<u64> = (0..200).map(|k| block_key([k, -k, 0])).collect();
        assert_eq!(blocks.get_or_create(&keys[..150], &progress), Ok((0..150).collect()));
        assert_eq!(blocks.get_or_create(&keys[100..], &progress), Ok((100..200).collect()));
        assert_eq!((blocks.count(), blocks.bytes()), (200, 256 * 6144));
        let wanted = [0, 3, 63, 64, 191, 199];
        for written in blocks.borrow_mut(&wanted) {
            written.distances.sum[0][0] += 1.0;
            written.colors.unwrap().levels[0][0][0] = 7;
            assert_eq!(written.block[1], -written.block[0]);
        }
        for (slot, &key) in keys.iter().enumerate() {
            let is_wanted = wanted.contains(&(slot as u32));
            assert_eq!(blocks.distances(slot).sum[0][0] > 0.0, is_wanted);
            assert_eq!(blocks.colors(slot).unwrap().levels[0][0][0] == 7, is_wanted);
            assert_eq!(blocks.key(slot), key);
        }
    }

    #[test]
    fn what_does_not_fit_is_not_begun() {
        let control = RunControl::default();
        let progress = Progress::new(&control);
        let mut blocks = BlockStorage::new(false, 3);
        let keys: Vec<u64> = (0..4).map(|k| block_key([k, 0, 0])).collect();
        assert_eq!(
            blocks.get_or_create(&keys, &progress),
            Err(KernelError::TooManyBlocks { wanted: 4, limit: 3 })
        );
        assert_eq!((blocks.count(), blocks.bytes()), (0, 0));
        assert_eq!(blocks.get_or_create(&keys[1..], &progress), Ok(vec![0, 1, 2]));
        assert!(blocks.colors(0).is_none());
    }
}
