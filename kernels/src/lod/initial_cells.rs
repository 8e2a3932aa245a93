//! Initial cells of a hierarchy: clusters of the input's triangles.
//!
//! Clustering all triangles with one queue would dominate the time of a level. Small clusters are therefore
//! built first, in parallel blocks, and then joined to cells across the whole mesh. Blocks are compact and
//! cell borders are chosen among all cluster borders, so few cell borders coincide with block borders.

use super::clustering::{Cell, Joint, cluster, contract_joints, joined, smooth_borders};
use super::dual_graph;
use crate::base::parallel::map;
use crate::certified::input_surface::InputSurface;
use crate::collapse::partition::Partition;

/// Triangles per block, chosen to fit in the CPU caches.
const BLOCK_TRIANGLES: usize = 4096;

/// Maximum triangles of a small cluster, and the minimum number of small clusters in a full cell.
const MAX_SMALL_CLUSTER: u32 = 32;
const MIN_CLUSTERS_PER_CELL: u32 = 256;

/// No triangle.
const NONE: u32 = u32::MAX;

/// Cluster triangles into cells of at most `most` triangles. Returns the cell of each triangle, the cells and
/// their adjacency. The result does not depend on the number of threads.
pub fn cluster_triangles<const D: usize>(
    original: &InputSurface<D>,
    most: u32,
    threads: usize,
) -> (Vec<u32>, Vec<Cell>, Vec<Joint>) {
    let InputSurface { points, triangles, .. } = original;
    let mut joints = dual_graph::find_shared_edges(points, triangles);
    let sides = joints.len();
    joints.extend(dual_graph::link_components(points, triangles, &joints));
    let single = dual_graph::make_cells(points, triangles);
    let small = MAX_SMALL_CLUSTER.min(most / MIN_CLUSTERS_PER_CELL);
    let of = if small > 1 {
        let blocks = Partition::new(points, triangles, triangles.len().div_ceil(BLOCK_TRIANGLES), 0, threads);
        let small = cluster_in_blocks(&single, &joints, small, &blocks, threads);
        let clusters = joined(&single, &joints, &small);
        let group = cluster(clusters, &contract_joints(&joints, &small), most);
        small.iter().map(|&cluster| group[cluster as usize]).collect()
    } else {
        cluster(single.clone(), &joints, most)
    };
    let of = smooth_borders(of, &joints[..sides], most);
    let (cells, joints) = (joined(&single, &joints, &of), contract_joints(&joints, &of));
    (of, cells, joints)
}

/// Cluster triangles within each block separately. Returns the cluster of each triangle.
fn cluster_in_blocks(
    cells: &[Cell],
    joints: &[Joint],
    most: u32,
    blocks: &Partition,
    threads: usize,
) -> Vec<u32> {
    // Block of each triangle, and its index in that block.
    let mut place = vec![[NONE; 2]; cells.len()];
    for block in 0..blocks.len() {
        (0..).zip(blocks.region(block)).for_each(|(i, &t)| place[t as usize] = [block as u32, i]);
    }
    let mut inside: Vec<Vec<Joint>> = vec![vec![]; blocks.len()];
    for joint in joints {
        let [[block, a], [other, b]] = joint.between.map(|t| place[t as usize]);
        if block == other {
            inside[block as usize].push(Joint { between: [a, b], ..*joint });
        }
    }
    let one = |(): &mut (), block: usize| {
        let own = blocks.region(block).iter().map(|&t| cells[t as usize]).collect();
        cluster(own, &inside[block], most)
    };
    let groups = map(blocks.len(), threads, || (), one);
    let mut of = vec![NONE; cells.len()];
    let mut first = 0;
    for (block, groups) in groups.iter().enumerate() {
        blocks.region(block).iter().zip(groups).for_each(|(&t, group)| of[t as usize] = first + group);
        first += groups.iter().max().map_or(0, |last| last + 1);
    }
    of
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Build a wavy height field of 2 · n² triangles.
    fn hills(n: u32) -> InputSurface<3> {
        let place = |i: u32| {
            let [x, y] = [i % (n + 1), i / (n + 1)].map(f64::from);
            [x, y, 6.0 * (0.11 * x).sin() * (0.07 * y).cos()]
        };
        let points = (0..(n + 1) * (n + 1)).map(place).collect();
        let corner = |i: u32| i / n * (n + 1) + i % n;
        let both = |c: u32| [[c, c + 1, c + n + 2], [c, c + n + 2, c + n + 1]];
        InputSurface::new(points, (0..n * n).flat_map(|i| both(corner(i))).collect())
    }

    #[test]
    fn cells_in_blocks_have_borders_as_short_as_those_of_one_queue() {
        let original = hills(100);
        let InputSurface { points, triangles, .. } = &original;
        let joints = dual_graph::find_shared_edges(points, triangles);
        let border = |of: &[u32]| {
            let differ = |joint: &&Joint| of[joint.between[0] as usize] != of[joint.between[1] as usize];
            joints.iter().filter(differ).map(|joint| joint.length).sum::<f64>()
        };
        for most in [20, 600, 3000] {
            let (of, cells, beside) = cluster_triangles(&original, most, 1);
            let one_queue = smooth_borders(
                cluster(dual_graph::make_cells(points, triangles), &joints, most),
                &joints,
                most,
            );
            let mut counts = vec![0; cells.len()];
            of.iter().for_each(|&cell| counts[cell as usize] += 1);
            assert!(cells.iter().zip(&counts).all(|(cell, &count)| cell.count == count && count <= most));
            assert!(counts.iter().all(|&count| count > 0));
            let between: f64 = beside.iter().map(|joint| joint.length).sum();
            assert!((between - border(&of)).abs() < 1e-9 * between, "{between}");
            let ratio = border(&of) / border(&one_queue);
            assert!(ratio < 1.1, "{most}: {ratio}");
            let several = cluster_triangles(&original, most, 3);
            assert_eq!(several.0, of);
        }
    }
}
