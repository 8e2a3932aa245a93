//! Partition of a mesh into compact regions of equal size, along planes that rotate from partition to
//! partition.

use crate::base::parallel::{fill, run_concurrently};

/// Triangles by region: region `p` is `triangles[starts[p]..starts[p + 1]]`, unordered.
pub struct Partition {
    pub triangles: Vec<u32>,
    pub starts: Vec<usize>,
}

/// A triangle to be sorted into a region.
#[derive(Clone, Copy, Default)]
struct Item {
    /// Centre of the triangle in the rotated frame, as order-preserving integers. Single precision suffices
    /// for sorting.
    centre: [u32; 3],
    triangle: u32,
}

/// Map a float to an integer of the same order, which compares without a branch.
fn rank(x: f32) -> u32 {
    let bits = x.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

/// Invert [`rank`].
fn unrank(rank: u32) -> f32 {
    f32::from_bits(if rank >> 31 == 1 { rank & !(1 << 31) } else { !rank })
}

impl Partition {
    /// Partition by recursive halving across the longest side (a k-d tree).
    ///
    /// `turn` is the index of the partition in a run. It rotates the planes, so that no edge stays on a rim.
    pub fn new<const D: usize>(
        points: &[[f64; D]],
        triangles: &[[u32; 3]],
        regions: usize,
        turn: usize,
        threads: usize,
    ) -> Self {
        if regions <= 1 {
            return Self {
                triangles: (0..triangles.len() as u32).collect(),
                starts: vec![0, triangles.len()],
            };
        }
        let frame = rotated_frame(turn);
        let mut items = vec![Item::default(); triangles.len()];
        fill(&mut items, threads, |t| {
            let sum: [f64; 3] =
                std::array::from_fn(|i| triangles[t].iter().map(|&v| points[v as usize][i]).sum());
            let along =
                |axis: &[f64; 3]| rank((axis[0] * sum[0] + axis[1] * sum[1] + axis[2] * sum[2]) as f32);
            Item { centre: [along(&frame[0]), along(&frame[1]), along(&frame[2])], triangle: t as u32 }
        });
        let mut starts = vec![0];
        leaf_sizes(items.len(), regions, &mut |size| starts.push(starts.last().unwrap_or(&0) + size));
        halve_recursively(&mut items, regions, threads);
        let order = items.iter().map(|item| item.triangle).collect();
        Self { triangles: order, starts }
    }

    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Return the triangles of a region.
    pub fn region(&self, p: usize) -> &[u32] {
        &self.triangles[self.starts[p]..self.starts[p + 1]]
    }
}

/// Number of triangles in the first half of the regions.
fn first_half_count(count: usize, regions: usize) -> usize {
    (count as u128 * (regions / 2) as u128 / regions as u128) as usize
}

fn leaf_sizes(count: usize, regions: usize, leaf: &mut impl FnMut(usize)) {
    if regions == 1 {
        return leaf(count);
    }
    let first = first_half_count(count, regions);
    leaf_sizes(first, regions / 2, leaf);
    leaf_sizes(count - first, regions - regions / 2, leaf);
}

fn halve_recursively(items: &mut [Item], regions: usize, threads: usize) {
    let first = first_half_count(items.len(), regions);
    if regions == 1 || first == 0 {
        return;
    }
    let axis = longest_side(items);
    items.select_nth_unstable_by_key(first, |item| {
        u64::from(item.centre[axis]) << 32 | u64::from(item.triangle)
    });
    let (near, far) = items.split_at_mut(first);
    run_concurrently(
        threads,
        || halve_recursively(near, regions / 2, threads / 2),
        || halve_recursively(far, regions - regions / 2, threads - threads / 2),
    );
}

fn longest_side(items: &[Item]) -> usize {
    let (mut low, mut high) = ([u32::MAX; 3], [0; 3]);
    for item in items {
        for i in 0..3 {
            low[i] = low[i].min(item.centre[i]);
            high[i] = high[i].max(item.centre[i]);
        }
    }
    let side = |i: usize| unrank(high[i]) - unrank(low[i]);
    (1..3).fold(0, |longest, i| if side(i) > side(longest) { i } else { longest })
}

/// Compute the orthonormal frame of a turn: rotations by the golden angle and by one radian about two axes.
fn rotated_frame(turn: usize) -> [[f64; 3]; 3] {
    let (a, b) = (2.399_963 * turn as f64, turn as f64);
    let ((sa, ca), (sb, cb)) = (a.sin_cos(), b.sin_cos());
    [[ca, sa, 0.0], [-sa * cb, ca * cb, sb], [sa * sb, -ca * sb, cb]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_triangle_is_in_one_region_for_any_number_of_threads() {
        let points: Vec<[f64; 3]> =
            (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), f64::from(i * 7 % 13)]).collect();
        let triangles: Vec<[u32; 3]> = (0..97).map(|i| [i, i + 1, i + 3]).collect();
        for regions in [1, 2, 3, 7, 20] {
            let one = Partition::new(&points, &triangles, regions, regions, 1);
            let two = Partition::new(&points, &triangles, regions, regions, 2);
            assert_eq!((&one.triangles, &one.starts), (&two.triangles, &two.starts));
            assert_eq!(one.len(), regions);
            let mut all = one.triangles.clone();
            all.sort_unstable();
            assert_eq!(all, (0..97).collect::<Vec<_>>());
            let sizes: Vec<usize> = one.starts.windows(2).map(|w| w[1] - w[0]).collect();
            assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 2, "{sizes:?}");
        }
    }

    #[test]
    fn ranks_are_in_the_order_of_the_numbers() {
        let numbers = [f32::NEG_INFINITY, -2.5, -1e-40, -0.0, 0.0, 1e-40, 3.0, f32::INFINITY];
        assert!(numbers.windows(2).all(|w| rank(w[0]) < rank(w[1])));
        assert!(numbers.iter().all(|&x| unrank(rank(x)).to_bits() == x.to_bits()));
    }

    #[test]
    fn frames_are_orthonormal() {
        for turn in 0..9 {
            let f = rotated_frame(turn);
            for i in 0..3 {
                for j in 0..3 {
                    let dot: f64 = (0..3).map(|k| f[i][k] * f[j][k]).sum();
                    assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12);
                }
            }
        }
    }
}
