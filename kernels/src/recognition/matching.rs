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
/// SIFT descriptor.
pub type Descriptor = [u8; DESCRIPTOR_LENGTH];
type RootedDescriptor = [i16; DESCRIPTOR_LENGTH];

/// Best match of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
struct BestMatch {
    index: usize,
    similarity: i32,
    /// Similarity of the second-best match.
    second_similarity: i32,
}

impl BestMatch {
    const NONE: Self = Self { index: 0, similarity: -1, second_similarity: -1 };

    /// Add a candidate. Among equal ones, the first stays the best.
    #[inline(always)]
    fn add(&mut self, index: usize, similarity: i32) {
        if similarity > self.similarity {
            *self = Self { index, similarity, second_similarity: self.similarity };
        } else {
            self.second_similarity = self.second_similarity.max(similarity);
        }
    }
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
    let [source, target] = [source, target].map(to_rootsift);
    let (likest, most) = compare(&source, &target);
    let is_match = |one: &BestMatch| {
        // Vectors of equal norm: the squared distance is 2 (norm² − dot product).
        let [near, next] = [one.similarity, one.second_similarity]
            .map(|likeness| ROOTED_NORM * ROOTED_NORM - likeness as f32);
        near < distinct * distinct * next && most[one.index] <= one.similarity
    };
    likest.iter().enumerate().filter(|(_, one)| is_match(one)).map(|(i, one)| [i, one.index]).collect()
}

by_processor! {
    /// Convert descriptors to RootSIFT with norm `ROOTED_NORM`; a zero descriptor stays zero.
    fn to_rootsift(descriptors: &[Descriptor]) -> Vec<RootedDescriptor> = to_rootsift_scalar
}

#[inline(always)]
fn to_rootsift_scalar(descriptors: &[Descriptor]) -> Vec<RootedDescriptor> {
    let mut rooted = vec![[0; DESCRIPTOR_LENGTH]; descriptors.len()];
    for (descriptor, result) in descriptors.iter().zip(&mut rooted) {
        let mut sum = 0;
        for &value in descriptor {
            sum += value as u32;
        }
        for (&value, result) in descriptor.iter().zip(result) {
            *result = (ROOTED_NORM * (value as f32 / sum.max(1) as f32).sqrt()).round() as i16;
        }
    }
    rooted
}

/// Find the best match of each source descriptor, and the largest similarity of each target descriptor.
fn compare(source: &[RootedDescriptor], target: &[RootedDescriptor]) -> (Vec<BestMatch>, Vec<i32>) {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
            // SAFETY: the processor supports AVX-512 F and BW.
            return unsafe { avx512::compare(source, target) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor supports AVX2.
            return unsafe { avx2::compare(source, target) };
        }
    }
    compare_scalar(source, target)
}

fn compare_scalar(source: &[RootedDescriptor], target: &[RootedDescriptor]) -> (Vec<BestMatch>, Vec<i32>) {
    let mut likest = vec![BestMatch::NONE; source.len()];
    let mut most = vec![-1; target.len()];
    for (one, best) in source.iter().zip(&mut likest) {
        for (j, (other, most)) in target.iter().zip(&mut most).enumerate() {
            let likeness: i32 = one.iter().zip(other).map(|(&a, &b)| a as i32 * b as i32).sum();
            *most = likeness.max(*most);
            best.add(j, likeness);
        }
    }
    (likest, most)
}

/// Number of pairs of adjacent elements of a descriptor.
#[cfg(target_arch = "x86_64")]
const PAIRS: usize = DESCRIPTOR_LENGTH / 2;

/// Pack pairs of adjacent elements, as vector instructions multiply them.
#[cfg(target_arch = "x86_64")]
fn pack_pairs(descriptor: &RootedDescriptor) -> [i32; PAIRS] {
    std::array::from_fn(|k| {
        (descriptor[2 * k] as u16 as u32 | (descriptor[2 * k + 1] as u16 as u32) << 16) as i32
    })
}

/// Define a module whose `compare` handles one target descriptor per lane of a vector, so that no sum runs
/// across lanes, and `SOURCES` source descriptors at a time, so that each loaded vector is used as often.
///
/// Closures and functions of arrays are avoided: without the target feature they are not inlined.
#[cfg(target_arch = "x86_64")]
macro_rules! compare_in_lanes {
    ($name:ident, $feature:literal, $lanes:literal, $vector:ident, $load:ident, $store:ident, $spread:ident,
     $zero:ident, $product:ident, $add:ident, $larger:ident, $smaller:ident,
     |$old:ident, $new:ident, $sum:ident, $best:ident| $select:expr) => {
        mod $name {
            use std::arch::x86_64::*;

            use crate::recognition::matching::{BestMatch, PAIRS, RootedDescriptor, pack_pairs};

            const LANES: usize = $lanes;
            const SOURCES: usize = 4;
            type Lanes = [i32; LANES];

            /// Similarities of a source descriptor in each lane: the best, its panel, and the second best.
            #[derive(Clone, Copy)]
            struct LaneMatch {
                best: Lanes,
                second: Lanes,
                panel: Lanes,
            }

            #[target_feature(enable = $feature)]
            pub fn compare(
                source: &[RootedDescriptor],
                target: &[RootedDescriptor],
            ) -> (Vec<BestMatch>, Vec<i32>) {
                let none = LaneMatch { best: [-1; LANES], second: [-1; LANES], panel: [0; LANES] };
                let mut source: Vec<_> = source.iter().map(pack_pairs).collect();
                let count = source.len();
                // Fill the last group; its additional results are dropped.
                source.resize(count.next_multiple_of(SOURCES), [0; PAIRS]);
                let mut likest = vec![none; source.len()];
                let mut most = vec![-1; target.len()];
                for (number, (targets, most)) in target.chunks(LANES).zip(most.chunks_mut(LANES)).enumerate()
                {
                    let panel = interleave(targets);
                    let mut largest = [-1; LANES];
                    let (groups, _) = source.as_chunks::<SOURCES>();
                    let (matches, _) = likest.as_chunks_mut::<SOURCES>();
                    for (group, matches) in groups.iter().zip(matches) {
                        update(group, &panel, number as i32, matches, &mut largest);
                    }
                    most.copy_from_slice(&largest[..most.len()]);
                }
                (likest[..count].iter().map(|one| reduce(one, target.len())).collect(), most)
            }

            /// Store each pair of all descriptors side by side; missing descriptors are zero.
            fn interleave(targets: &[RootedDescriptor]) -> [Lanes; PAIRS] {
                let mut panel = [[0; LANES]; PAIRS];
                for (lane, one) in targets.iter().enumerate() {
                    for (row, pair) in panel.iter_mut().zip(pack_pairs(one)) {
                        row[lane] = pair;
                    }
                }
                panel
            }

            #[target_feature(enable = $feature)]
            fn update(
                source: &[[i32; PAIRS]; SOURCES],
                panel: &[Lanes; PAIRS],
                number: i32,
                matches: &mut [LaneMatch; SOURCES],
                most: &mut Lanes,
            ) {
                let mut sums = [$zero(); SOURCES];
                for (k, row) in panel.iter().enumerate() {
                    let row = load(row);
                    for i in 0..SOURCES {
                        sums[i] = $add(sums[i], $product(row, $spread(source[i][k])));
                    }
                }
                let mut largest = load(most);
                for (found, sum) in matches.iter_mut().zip(sums) {
                    let (best, second, panel) = (load(&found.best), load(&found.second), load(&found.panel));
                    store(&mut found.second, $larger(second, $smaller(best, sum)));
                    store(&mut found.panel, select(panel, $spread(number), sum, best));
                    store(&mut found.best, $larger(best, sum));
                    largest = $larger(largest, sum);
                }
                store(most, largest);
            }

            #[inline]
            #[target_feature(enable = $feature)]
            fn load(from: &Lanes) -> $vector {
                // SAFETY: the array has the size of a vector.
                unsafe { $load(from.as_ptr().cast()) }
            }

            #[inline]
            #[target_feature(enable = $feature)]
            fn store(to: &mut Lanes, value: $vector) {
                // SAFETY: the array has the size of a vector.
                unsafe { $store(to.as_mut_ptr().cast(), value) }
            }

            /// Return `new` in lanes with a better sum, else `old`.
            #[inline]
            #[target_feature(enable = $feature)]
            fn select($old: $vector, $new: $vector, $sum: $vector, $best: $vector) -> $vector {
                $select
            }

            /// Combine the lanes; `count` target descriptors exist.
            fn reduce(lanes: &LaneMatch, count: usize) -> BestMatch {
                let index = |lane: usize| lanes.panel[lane] as usize * LANES + lane;
                let used = 0..LANES.min(count);
                let first = used.clone().max_by_key(|&lane| (lanes.best[lane], usize::MAX - index(lane)));
                let Some(first) = first else { return BestMatch::NONE };
                let others = used.clone().filter(|&lane| lane != first).map(|lane| lanes.best[lane]);
                let seconds = used.map(|lane| lanes.second[lane]);
                BestMatch {
                    index: index(first),
                    similarity: lanes.best[first],
                    second_similarity: others.chain(seconds).max().unwrap_or(-1),
                }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
compare_in_lanes!(
    avx2,
    "avx2",
    8,
    __m256i,
    _mm256_loadu_si256,
    _mm256_storeu_si256,
    _mm256_set1_epi32,
    _mm256_setzero_si256,
    _mm256_madd_epi16,
    _mm256_add_epi32,
    _mm256_max_epi32,
    _mm256_min_epi32,
    |old, new, sum, best| _mm256_blendv_epi8(old, new, _mm256_cmpgt_epi32(sum, best))
);
#[cfg(target_arch = "x86_64")]
compare_in_lanes!(
    avx512,
    "avx512f,avx512bw",
    16,
    __m512i,
    _mm512_loadu_si512,
    _mm512_storeu_si512,
    _mm512_set1_epi32,
    _mm512_setzero_si512,
    _mm512_madd_epi16,
    _mm512_add_epi32,
    _mm512_max_epi32,
    _mm512_min_epi32,
    |old, new, sum, best| _mm512_mask_mov_epi32(old, _mm512_cmpgt_epi32_mask(sum, best), new)
);

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
        // Counts that fill no vector, and equal descriptors, whose first one is the best match.
        for (sources, targets) in [(1, 2), (70, 150), (9, 7), (13, 33)] {
            let mut target = some(targets, 7);
            target[targets - 1] = target[targets / 2];
            let mut source = some(sources, 6);
            source[0] = target[targets / 2];
            let [source, target] = [source, target].map(|all| to_rootsift_scalar(&all));
            let expected = compare_scalar(&source, &target);
            assert_eq!(compare(&source, &target), expected);
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the processor supports AVX2.
                assert_eq!(unsafe { avx2::compare(&source, &target) }, expected);
            }
        }
    }

    #[test]
    fn rooted_descriptors_have_equal_bits() {
        let all = some(300, 8);
        assert_eq!(to_rootsift(&all), to_rootsift_scalar(&all));
    }
}
