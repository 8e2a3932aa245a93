use std::collections::{HashMap, HashSet};

use super::*;
use crate::base::progress::RunControl;

/// Blocks whose voxel values are a function of position.
struct SyntheticField<D> {
    blocks: Vec<[i32; 3]>,
    distance: D,
}

impl<D: Fn([i32; 3]) -> f32 + Sync> SyntheticField<D> {
    fn cube(reach: i32, distance: D) -> Self {
        let side = 2 * reach;
        let block = |i: i32| [i % side - reach, i / side % side - reach, i / (side * side) - reach];
        // Reversed, so that the order differs from the result's order.
        Self { blocks: (0..side.pow(3)).rev().map(block).collect(), distance }
    }

    fn at(&self, slot: usize, voxel: usize) -> [i32; 3] {
        let place = voxel_position(voxel);
        std::array::from_fn(|k| self.blocks[slot][k] * BLOCK_SIDE as i32 + place[k] as i32)
    }

    fn surface(&self, own: Option<BlockBox>, threads: usize) -> ExtractedSurface {
        extract_surface(self, 1, own, threads, &Progress::new(&RunControl::default())).unwrap()
    }
}

impl<D: Fn([i32; 3]) -> f32 + Sync> DistanceField for SyntheticField<D> {
    fn block_count(&self) -> usize {
        self.blocks.len()
    }

    fn block_coordinates(&self, slot: usize) -> [i32; 3] {
        self.blocks[slot]
    }

    fn distances(&self, slot: usize, least: u32, into: &mut [f32; BLOCK_VOXELS]) {
        for (voxel, into) in into.iter_mut().enumerate() {
            *into = self.distance(slot, voxel, least);
        }
    }

    fn distance(&self, slot: usize, voxel: usize, _: u32) -> f32 {
        (self.distance)(self.at(slot, voxel))
    }

    fn sample(&self, slot: usize, voxel: usize) -> VoxelSample {
        let at = self.at(slot, voxel).map(|c| c as f32);
        VoxelSample { color: at, observation_count: at[0] + 2.0 * at[1], cosine: at[2] }
    }
}

fn sphere([x, y, z]: [i32; 3]) -> f32 {
    let [x, y, z] = [x, y, z].map(|c| f64::from(c) + 0.3);
    ((x * x + y * y + z * z).sqrt() - 9.0) as f32
}

/// Hash a position to a pseudo-random number from 0 to 1.
fn noise([x, y, z]: [i32; 3], seed: u64) -> f32 {
    let mut h = seed ^ (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for c in [y, z] {
        h = (h ^ h >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
            ^ (c as u64).wrapping_mul(0x94d0_49bb_1331_11eb);
    }
    h = (h ^ h >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    ((h ^ h >> 32) >> 40) as f32 / (1 << 24) as f32
}

/// Random signs, with a ratio of unknown voxels.
fn random_signs(seed: u64, unknown: f32) -> impl Fn([i32; 3]) -> f32 + Sync {
    move |at| {
        let zeros = [0.0, -0.0, noise(at, seed + 2) - 0.5];
        if noise(at, seed) < unknown {
            f32::NAN
        } else {
            zeros[(noise(at, seed + 1) * 5.0).min(2.0) as usize]
        }
    }
}

fn sides(triangles: &[[u32; 3]]) -> impl Iterator<Item = [u32; 2]> + '_ {
    triangles.iter().flat_map(|t| (0..3).map(|k| [t[k], t[(k + 1) % 3]]))
}

/// Check that every edge has one or two triangles with consistent orientation, that no vertex joins two fans,
/// and that none is unused.
fn assert_manifold(found: &ExtractedSurface) {
    let mut directed = HashSet::new();
    assert!(
        sides(&found.triangles).all(|side| directed.insert(side)),
        "two triangles run alike through an edge"
    );
    let mut next: HashMap<u32, Vec<(u32, u32)>> = HashMap::new();
    for &[a, b, c] in &found.triangles {
        for [at, from, to] in [[a, b, c], [b, c, a], [c, a, b]] {
            next.entry(at).or_default().push((from, to));
        }
    }
    assert_eq!(next.len(), found.positions.len(), "a vertex without a triangle");
    for (vertex, fan) in next {
        let steps: HashMap<u32, u32> = fan.iter().copied().collect();
        let ends: HashSet<u32> = fan.iter().map(|f| f.1).collect();
        let start = fan.iter().map(|f| f.0).find(|from| !ends.contains(from)).unwrap_or(fan[0].0);
        let (mut at, mut count) = (start, 0);
        while let Some(&to) = steps.get(&at) {
            (at, count) = (to, count + 1);
            if at == start {
                break;
            }
        }
        assert_eq!(count, fan.len(), "vertex {vertex} joins two fans");
    }
}

#[test]
fn a_sphere_is_closed_and_looks_outward() {
    let found = SyntheticField::cube(2, sphere).surface(None, 2);
    assert_manifold(&found);
    let edges: HashSet<[u32; 2]> = sides(&found.triangles).collect();
    assert!(edges.iter().all(|&[a, b]| edges.contains(&[b, a])));
    assert_eq!(found.positions.len() + found.triangles.len() - edges.len() / 2, 2);
    let volume: f64 = found
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| found.positions[v as usize]);
            (a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]))
                / 6.0
        })
        .sum();
    let expected = 4.0 / 3.0 * std::f64::consts::PI * 9_f64.powi(3);
    assert!((volume / expected - 1.0).abs() < 0.01, "{volume} instead of {expected}");
    for p in &found.positions {
        let r = p.iter().map(|c| (c + 0.3) * (c + 0.3)).sum::<f64>().sqrt();
        assert!((r - 9.0).abs() < 0.03, "{r}");
    }
}

#[test]
fn each_vertex_lies_on_its_edge_where_the_distance_is_zero() {
    let found = SyntheticField::cube(1, |[x, _, _]| x as f32 - 2.25).surface(None, 1);
    assert!(found.positions.iter().all(|p| p[0] == 2.25 && p[1].fract() == 0.0 && p[2].fract() == 0.0));
    for (p, s) in found.positions.iter().zip(&found.samples) {
        assert_eq!(s.color.map(f64::from), *p);
        assert_eq!(f64::from(s.observation_count), p[0] + 2.0 * p[1]);
    }
}

#[test]
fn any_signs_with_any_gaps_give_a_manifold() {
    for (seed, unknown) in [(1, 0.0), (2, 0.02), (3, 0.1), (4, 0.3), (5, 0.5)] {
        let found = SyntheticField::cube(1, random_signs(seed, unknown)).surface(None, 2);
        assert!(!found.triangles.is_empty());
        assert_manifold(&found);
        for &t in &found.triangles {
            let [a, b, c] = t.map(|v| found.positions[v as usize]);
            assert!(a != b && b != c && c != a, "a triangle without area");
        }
    }
}

#[test]
fn the_vertices_are_those_of_a_plain_search() {
    let distance = random_signs(7, 0.1);
    let found = SyntheticField::cube(1, &distance).surface(None, 2);
    let known = |cube: [i32; 3]| {
        (0..8).all(|c| {
            let at: [i32; 3] = std::array::from_fn(|k| cube[k] + (c >> k & 1));
            at.iter().all(|c| (-8..8).contains(c)) && !distance(at).is_nan()
        })
    };
    let mut expected = HashSet::new();
    for i in 0..16 * 16 * 16 {
        let at = [i % 16 - 8, i / 16 % 16 - 8, i / 256 - 8];
        for axis in 0..3 {
            let away = |by: [i32; 3]| std::array::from_fn(|k| at[k] + by[(k + 3 - axis) % 3]);
            let there = away([1, 0, 0]);
            let beside = [[0, 0, 0], [0, -1, 0], [0, 0, -1], [0, -1, -1]].map(away);
            if beside.into_iter().any(known) && (distance(at) < 0.0) != (distance(there) < 0.0) {
                expected.insert((at, axis));
            }
        }
    }
    let on_edges: HashSet<([i32; 3], usize)> = found
        .positions
        .iter()
        .map(|p| (p.map(|c| c.floor() as i32), (0..3).find(|&k| p[k].fract() != 0.0).unwrap()))
        .collect();
    let wrong: Vec<_> = on_edges.symmetric_difference(&expected).take(5).collect();
    assert!(wrong.is_empty(), "{} and {} vertices, such as {wrong:?}", on_edges.len(), expected.len());
}

#[test]
fn threads_and_the_order_of_blocks_change_nothing() {
    let mut made = SyntheticField::cube(2, random_signs(3, 0.2));
    let one = made.surface(None, 1);
    made.blocks.sort_unstable();
    assert_eq!(made.surface(None, 3), one);
}

#[test]
fn pieces_with_a_rim_give_the_whole_to_the_bit() {
    let whole = SyntheticField::cube(2, random_signs(11, 0.2)).surface(None, 1);
    // Bricks of 2³ blocks in Z-order; each field has only the brick's blocks and the adjacent ones.
    let mut lows: Vec<[i32; 3]> = (0..8).map(|i| [i % 2, i / 2 % 2, i / 4].map(|c| 2 * c - 2)).collect();
    lows.sort_unstable_by_key(|&low| block_order::block_key(low));
    let mut joined = ExtractedSurface::default();
    let mut numbers: HashMap<EdgeKey, u32> = HashMap::new();
    let mut pieces = vec![];
    for low in lows {
        let own = BlockBox { low, high: low.map(|c| c + 2) };
        let rim = BlockBox { low: low.map(|c| c - 1), high: low.map(|c| c + 3) };
        let mut made = SyntheticField::cube(2, random_signs(11, 0.2));
        made.blocks.retain(|&block| rim.contains(block));
        let piece = made.surface(Some(own), 1);
        let first = joined.positions.len() as u32;
        joined.positions.extend_from_slice(&piece.positions);
        joined.samples.extend_from_slice(&piece.samples);
        numbers.extend(piece.shared.iter().map(|&(key, number)| (key, first + number)));
        pieces.push((first, piece));
    }
    for (first, piece) in pieces {
        let own = piece.positions.len() as u32;
        joined.triangles.extend(piece.triangles.iter().map(|t| {
            t.map(|v| if v < own { first + v } else { numbers[&piece.foreign[(v - own) as usize]] })
        }));
    }
    assert_eq!(joined, whole);
}
