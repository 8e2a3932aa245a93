//! Mutual nearest-neighbour matching of image descriptors.
//!
//! Descriptors are compared as RootSIFT (Arandjelović and Zisserman, "Three things everyone should know to
//! improve object retrieval", 2012), in integer arithmetic, so that matches are identical on every processor.

use crate::base::by_processor::by_processor;

/// Length of a descriptor.
pub const DESCRIPTOR_LENGTH: usize = 128;
/// Norm of a RootSIFT descriptor. Dot products of two of them fit 32 bits; rounding adds at most one per
/// cent.
const ROOTED_NORM: f32 = 16384.0;
/// Target descriptors per block; the block stays in the L1 cache.
const TARGETS_PER_BLOCK: usize = 64;

/// SIFT descriptor.
pub type Descriptor = [u8; DESCRIPTOR_LENGTH];
type RootedDescriptor = [i16; DESCRIPTOR_LENGTH];

/// Best match of a descriptor so far.
#[derive(Clone, Copy)]
struct BestMatch {
    index: usize,
    similarity: i32,
    /// Similarity of the second-best match.
    second_similarity: i32,
}

/// Match descriptors that are mutual nearest neighbours. Returns index pairs (source, target) in the order of
/// `source`.
///
/// The distance to the nearest neighbour must be less than `distinct` times the distance to the second
/// nearest (Lowe's ratio test). A single target therefore has no matches.
pub fn match_mutual_nearest(source: &[Descriptor], target: &[Descriptor], distinct: f32) -> Vec<[usize; 2]> {
    if target.len() < 2 {
        return Vec::new();
    }
    let source: Vec<RootedDescriptor> = source.iter().map(to_rootsift).collect();
    let target: Vec<RootedDescriptor> = target.iter().map(to_rootsift).collect();
    let mut likest = vec![BestMatch { index: 0, similarity: -1, second_similarity: -1 }; source.len()];
    let mut most = vec![-1; target.len()];
    compare_blocks(&source, &target, &mut likest, &mut most);
    let is_match = |one: &BestMatch| {
        // Vectors of equal norm: the squared distance is 2 (norm² − dot product).
        let [near, next] = [one.similarity, one.second_similarity]
            .map(|likeness| ROOTED_NORM * ROOTED_NORM - likeness as f32);
        near < distinct * distinct * next && most[one.index] <= one.similarity
    };
    likest.iter().enumerate().filter(|(_, one)| is_match(one)).map(|(i, one)| [i, one.index]).collect()
}

/// Convert a descriptor to RootSIFT with norm `ROOTED_NORM`; a zero descriptor stays zero.
fn to_rootsift(descriptor: &Descriptor) -> RootedDescriptor {
    let sum: u32 = descriptor.iter().map(|&value| value as u32).sum();
    descriptor.map(|value| (ROOTED_NORM * (value as f32 / sum.max(1) as f32).sqrt()).round() as i16)
}

by_processor! {
    fn compare_blocks(source: &[RootedDescriptor], target: &[RootedDescriptor], likest: &mut [BestMatch], most: &mut [i32]) = compare_blocks_scalar
}

#[inline(always)]
fn compare_blocks_scalar(
    source: &[RootedDescriptor],
    target: &[RootedDescriptor],
    likest: &mut [BestMatch],
    most: &mut [i32],
) {
    for (block, (targets, most)) in
        target.chunks(TARGETS_PER_BLOCK).zip(most.chunks_mut(TARGETS_PER_BLOCK)).enumerate()
    {
        for (one, best) in source.iter().zip(likest.iter_mut()) {
            for (j, (other, most)) in targets.iter().zip(most.iter_mut()).enumerate() {
                let likeness: i32 = one.iter().zip(other).map(|(&a, &b)| a as i32 * b as i32).sum();
                *most = likeness.max(*most);
                if likeness > best.similarity {
                    *best = BestMatch {
                        index: block * TARGETS_PER_BLOCK + j,
                        similarity: likeness,
                        second_similarity: best.similarity,
                    };
                } else if likeness > best.second_similarity {
                    best.second_similarity = likeness;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random descriptors, sparse like SIFT.
    fn some(count: usize, mut seed: u64) -> Vec<Descriptor> {
        let mut next = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let value = (seed >> 33) as u8;
            if value < 96 { 0 } else { value }
        };
        (0..count).map(|_| std::array::from_fn(|_| next())).collect()
    }

    #[test]
    fn what_was_shuffled_is_found() {
        let source = some(200, 1);
        let mut target: Vec<Descriptor> = source.iter().rev().copied().collect();
        for one in &mut target {
            one[5] = one[5].saturating_add(20);
        }
        let expected: Vec<[usize; 2]> = (0..200).map(|i| [i, 199 - i]).collect();
        assert_eq!(match_mutual_nearest(&source, &target, 0.8), expected);
    }

    #[test]
    fn what_is_there_twice_is_not_distinct() {
        let source = some(20, 2);
        let mut target = source.clone();
        target.push(source[7]);
        let found = match_mutual_nearest(&source, &target, 0.8);
        assert_eq!(found.len(), 19);
        assert!(found.iter().all(|&[i, j]| i == j && i != 7));
    }

    #[test]
    fn of_two_with_one_likest_the_nearer_is_taken() {
        let mut source = some(2, 3);
        let target = vec![source[0], some(1, 4)[0]];
        source[1] = source[0];
        source[1][0] = source[1][0].wrapping_add(100);
        assert_eq!(match_mutual_nearest(&source, &target, 0.8), [[0, 0]]);
    }

    #[test]
    fn nothing_matches_one_or_none() {
        let few = some(3, 5);
        assert!(match_mutual_nearest(&few, &few[..1], 0.8).is_empty());
        assert!(match_mutual_nearest(&[], &few, 0.8).is_empty());
        // Zero descriptors are all equal, and therefore not distinct.
        assert!(
            match_mutual_nearest(&[[0; DESCRIPTOR_LENGTH]; 3], &[[0; DESCRIPTOR_LENGTH]; 3], 0.8).is_empty()
        );
    }

    #[test]
    fn wide_instructions_give_the_same() {
        let (source, target) = (some(70, 6), some(150, 7));
        let [source, target] = [source, target].map(|all| all.iter().map(to_rootsift).collect::<Vec<_>>());
        let ends = [compare_blocks, compare_blocks_scalar].map(|run| {
            let mut likest =
                vec![BestMatch { index: 0, similarity: -1, second_similarity: -1 }; source.len()];
            let mut most = vec![-1; target.len()];
            run(&source, &target, &mut likest, &mut most);
            (
                likest
                    .iter()
                    .map(|one| [one.index as i32, one.similarity, one.second_similarity])
                    .collect::<Vec<_>>(),
                most,
            )
        });
        assert_eq!(ends[0], ends[1]);
    }
}
