//! Hierarchical clustering on the dual graph: adjacent cells are joined in the order of the joint cell's
//! cost.
//!
//! Garland, Willmott and Heckbert, "Hierarchical face clustering on polygonal surfaces", 2001. The cost
//! combines flatness, similarity of normals and compactness. Compactness has the largest weight here, because
//! long borders cost triangles on later levels. Costs grow with the triangle count, so cells grow evenly.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::base::geometry::{Vec3, cross, dot, norm2, sub};

/// Weights relative to compactness: of the spread of normals, and of the mean squared distance from the mean
/// plane in units of the cell area.
const NORMAL_SPREAD_WEIGHT: f64 = 0.5;
const FLATNESS_WEIGHT: f64 = 4.0;

/// No cell.
const NONE: u32 = u32::MAX;

/// Accumulated geometry of a cell, sufficient to compute its cost.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Number of triangles in the current mesh.
    pub count: u32,
    pub perimeter: f64,
    area: f64,
    /// Sum of the area-weighted normals.
    normal: Vec3,
    /// Area-weighted first and second moments of positions; second moments in the order xx, yy, zz, xy, yz,
    /// zx.
    first_moment: Vec3,
    second_moments: [f64; 6],
}

impl Cell {
    /// Create the cell of one triangle.
    pub fn from_triangle([a, b, c]: [Vec3; 3]) -> Self {
        let normal = cross(&sub(&b, &a), &sub(&c, &a)).map(|x| 0.5 * x);
        let area = norm2(&normal).sqrt();
        let middle = [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0);
        let side = |p: &Vec3, q: &Vec3| norm2(&sub(p, q)).sqrt();
        let product = |i: usize, j: usize| area * middle[i] * middle[j];
        Self {
            count: 1,
            perimeter: side(&a, &b) + side(&b, &c) + side(&c, &a),
            area,
            normal,
            first_moment: middle.map(|x| area * x),
            second_moments: [
                product(0, 0),
                product(1, 1),
                product(2, 2),
                product(0, 1),
                product(1, 2),
                product(2, 0),
            ],
        }
    }

    /// Join two cells. `shared` is the length of their common border.
    pub fn join(&self, other: &Self, shared: f64) -> Self {
        let sum = |a: &Vec3, b: &Vec3| [0, 1, 2].map(|i| a[i] + b[i]);
        Self {
            count: self.count + other.count,
            perimeter: (self.perimeter + other.perimeter - 2.0 * shared).max(0.0),
            area: self.area + other.area,
            normal: sum(&self.normal, &other.normal),
            first_moment: sum(&self.first_moment, &other.first_moment),
            second_moments: std::array::from_fn(|i| self.second_moments[i] + other.second_moments[i]),
        }
    }

    fn cost(&self) -> f64 {
        if self.area <= 0.0 {
            return 0.0;
        }
        let length = norm2(&self.normal).sqrt();
        let compactness = self.perimeter * self.perimeter / (4.0 * std::f64::consts::PI * self.area);
        let spread = 1.0 - length / self.area;
        let n = self.normal.map(|x| x / length.max(f64::MIN_POSITIVE));
        let [xx, yy, zz, xy, yz, zx] = self.second_moments;
        let along = n[0] * n[0] * xx
            + n[1] * n[1] * yy
            + n[2] * n[2] * zz
            + 2.0 * (n[0] * n[1] * xy + n[1] * n[2] * yz + n[2] * n[0] * zx);
        let mean = dot(&n, &self.first_moment) / self.area;
        let variance = (along / self.area - mean * mean).max(0.0);
        f64::from(self.count)
            * (compactness + NORMAL_SPREAD_WEIGHT * spread + FLATNESS_WEIGHT * variance / self.area)
    }
}

/// Edge of the dual graph: two adjacent cells and the length of their common border.
#[derive(Clone, Copy, Debug)]
pub struct Joint {
    pub between: [u32; 2],
    pub length: f64,
}

/// Cost of joining two cells, packed with their indices. Smaller values are joined first; integers compare
/// without branches.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct JoinCandidate(u128);

impl JoinCandidate {
    /// `owner` (0 or 1) selects the cell of the pair whose best candidate this is.
    fn new(cost: f64, [a, b]: [u32; 2], owner: usize) -> Self {
        let bits = cost.to_bits();
        let rank = if bits >> 63 == 0 { bits | 1 << 63 } else { !bits };
        Self(u128::from(rank) << 64 | u128::from(a) << 32 | u128::from(b) << 1 | owner as u128)
    }

    fn cells(self) -> [u32; 2] {
        [(self.0 >> 32) as u32, self.0 as u32 >> 1]
    }

    fn owner(self) -> usize {
        self.0 as usize & 1
    }
}

/// Join adjacent cells while the result has at most `most` triangles. Returns the group of each cell,
/// numbered in the order of their first cells.
pub fn cluster(mut cells: Vec<Cell>, joints: &[Joint], most: u32) -> Vec<u32> {
    let count = cells.len();
    let mut into: Vec<u32> = (0..count as u32).collect();
    // Number of changes of each cell.
    let mut versions = vec![0u32; count];
    let mut neighbours: Vec<Vec<(u32, f64)>> = vec![vec![]; count];
    for joint in joints.iter().filter(|joint| joint.between[0] != joint.between[1]) {
        let [a, b] = joint.between;
        neighbours[a as usize].push((b, joint.length));
        neighbours[b as usize].push((a, joint.length));
    }
    // Scratch index for adding up the border length per neighbour.
    let mut place = vec![NONE; count];
    neighbours.iter_mut().for_each(|list| merge_neighbours(list, &into, NONE, &mut place));
    // One heap entry per cell suffices, because the globally best pair is the best of its more recently
    // changed cell. A stale entry is recomputed when it is popped.
    let best = |cells: &[Cell], versions: &[u32], own: u32, list: &[(u32, f64)]| {
        let offer = |&(other, shared): &(u32, f64)| {
            let (a, b) = (own.min(other), own.max(other));
            let (first, second) = (&cells[a as usize], &cells[b as usize]);
            let fits = first.count + second.count <= most;
            fits.then(|| {
                JoinCandidate::new(first.join(second, shared).cost(), [a, b], usize::from(own > other))
            })
        };
        let best: Option<JoinCandidate> = list.iter().filter_map(offer).min();
        best.map(|offer| (offer, offer.cells().map(|c| versions[c as usize])))
    };
    // Current entry of each cell, and the versions of both cells at that time.
    let mut offered: Vec<Option<(JoinCandidate, [u32; 2])>> = vec![None; count];
    let mut offers = BinaryHeap::with_capacity(count);
    for (own, list) in (0..).zip(&neighbours) {
        offered[own as usize] = best(&cells, &versions, own, list);
        offers.extend(offered[own as usize].map(|(offer, _)| Reverse(offer)));
    }
    while let Some(Reverse(offer)) = offers.pop() {
        let pair = offer.cells();
        let own = pair[offer.owner()];
        let Some((latest, then)) = offered[own as usize] else { continue };
        if latest != offer {
            continue;
        }
        let [a, b] = pair.map(|c| c as usize);
        if then != [a, b].map(|c| versions[c]) {
            offered[own as usize] = best(&cells, &versions, own, &neighbours[own as usize]);
            offers.extend(offered[own as usize].map(|(offer, _)| Reverse(offer)));
            continue;
        }
        let shared = neighbours[a].iter().find(|(c, _)| *c == pair[1]).map_or(0.0, |(_, length)| *length);
        cells[a] = cells[a].join(&cells[b], shared);
        into[b] = pair[0];
        offered[b] = None;
        [a, b].into_iter().for_each(|c| versions[c] += 1);
        let (mut list, mut other) = (std::mem::take(&mut neighbours[a]), std::mem::take(&mut neighbours[b]));
        if list.len() < other.len() {
            std::mem::swap(&mut list, &mut other);
        }
        list.extend(other);
        merge_neighbours(&mut list, &into, pair[0], &mut place);
        for &(c, shared) in &list {
            // The neighbour's list still refers to the two separate cells.
            let theirs = &mut neighbours[c as usize];
            theirs.retain(|(d, _)| *d != pair[0] && *d != pair[1]);
            theirs.push((pair[0], shared));
        }
        offered[a] = best(&cells, &versions, pair[0], &list);
        offers.extend(offered[a].map(|(offer, _)| Reverse(offer)));
        neighbours[a] = list;
    }
    number_groups(&into)
}

/// Update a neighbour list: merge duplicates and remove `own`.
fn merge_neighbours(list: &mut Vec<(u32, f64)>, into: &[u32], own: u32, place: &mut [u32]) {
    let mut kept = 0;
    for i in 0..list.len() {
        let (c, length) = list[i];
        let c = into[c as usize];
        if c == own {
            continue;
        }
        match place[c as usize] {
            NONE => {
                place[c as usize] = kept as u32;
                list[kept] = (c, length);
                kept += 1;
            }
            at => list[at as usize].1 += length,
        }
    }
    list.truncate(kept);
    list.iter().for_each(|(c, _)| place[*c as usize] = NONE);
}

/// Number the groups in the order of their first members. `into` links each member to its group's root.
fn number_groups(into: &[u32]) -> Vec<u32> {
    let mut number = vec![NONE; into.len()];
    let mut next = 0;
    let mut group = |c: usize| {
        let mut root = c;
        while into[root] as usize != root {
            root = into[root] as usize;
        }
        if number[root] == NONE {
            number[root] = next;
            next += 1;
        }
        number[root]
    };
    (0..into.len()).map(&mut group).collect()
}

/// Maximum number of border smoothing passes over all triangles.
const MAX_SMOOTHING_PASSES: usize = 6;

/// Shorten borders by moving triangles to the group of two of their neighbours.
pub fn smooth_borders(mut group: Vec<u32>, joints: &[Joint], most: u32) -> Vec<u32> {
    let mut beside = vec![[NONE; 3]; group.len()];
    for joint in joints {
        for [t, other] in [joint.between, [joint.between[1], joint.between[0]]] {
            if let Some(free) = beside[t as usize].iter_mut().find(|b| **b == NONE) {
                *free = other;
            }
        }
    }
    let mut counts = vec![0u32; group.iter().max().map_or(0, |&g| g as usize + 1)];
    group.iter().for_each(|&g| counts[g as usize] += 1);
    for _ in 0..MAX_SMOOTHING_PASSES {
        let mut moved = false;
        for t in 0..group.len() {
            let own = group[t];
            let of = |i: usize| beside[t][i].min(group.len() as u32);
            let groups = [0, 1, 2].map(|i| group.get(of(i) as usize).copied().unwrap_or(NONE));
            let pairs = [(0, 1), (1, 2), (2, 0)];
            let same = pairs.iter().find(|(i, j)| groups[*i] == groups[*j] && groups[*i] != NONE);
            let Some(to) = same.map(|(i, _)| groups[*i]).filter(|&to| to != own) else { continue };
            if counts[to as usize] < most && counts[own as usize] > 1 {
                counts[own as usize] -= 1;
                counts[to as usize] += 1;
                group[t] = to;
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
    group
}

/// Compute the border lengths between groups from those between their members.
pub fn contract_joints(joints: &[Joint], group: &[u32]) -> Vec<Joint> {
    let mut between: Vec<([u32; 2], f64)> = joints
        .iter()
        .filter_map(|joint| {
            let [a, b] = joint.between.map(|t| group[t as usize]);
            (a != b).then_some(([a.min(b), a.max(b)], joint.length))
        })
        .collect();
    // Sort lengths, too, so that floating-point sums do not depend on the order of `joints`.
    between.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let same = between.chunk_by(|a, b| a.0 == b.0);
    same.map(|pairs| Joint { between: pairs[0].0, length: pairs.iter().map(|p| p.1).sum() }).collect()
}

/// Compute the cells of groups from the cells and joints of their members.
pub fn joined(cells: &[Cell], joints: &[Joint], group: &[u32]) -> Vec<Cell> {
    let mut whole: Vec<Option<Cell>> = vec![None; group.iter().max().map_or(0, |&g| g as usize + 1)];
    for (cell, &g) in cells.iter().zip(group) {
        let sum = &mut whole[g as usize];
        *sum = Some(sum.map_or(*cell, |sum| sum.join(cell, 0.0)));
    }
    for joint in joints {
        let [a, b] = joint.between.map(|t| group[t as usize]);
        if let Some(cell) = whole[a as usize].as_mut().filter(|_| a == b) {
            cell.perimeter = (cell.perimeter - 2.0 * joint.length).max(0.0);
        }
    }
    whole.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference implementation that searches all adjacent pairs for each join.
    fn brute(mut cells: Vec<Cell>, joints: &[Joint], most: u32) -> Vec<u32> {
        let mut into: Vec<u32> = (0..cells.len() as u32).collect();
        let mut borders: std::collections::BTreeMap<[u32; 2], f64> = Default::default();
        for Joint { between: [a, b], length } in joints {
            *borders.entry([*a.min(b), *a.max(b)]).or_default() += length;
        }
        loop {
            let cost = |(pair, shared): (&[u32; 2], &f64)| {
                let joined = cells[pair[0] as usize].join(&cells[pair[1] as usize], *shared);
                (joined.count <= most).then(|| (joined.cost(), *pair))
            };
            let best = borders.iter().filter_map(cost).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let Some((_, [a, b])) = best else { return number_groups(&into) };
            let shared = borders.remove(&[a, b]).unwrap_or(0.0);
            cells[a as usize] = cells[a as usize].join(&cells[b as usize], shared);
            into[b as usize] = a;
            for (pair, length) in std::mem::take(&mut borders) {
                let [c, d] = pair.map(|c| if c == b { a } else { c });
                *borders.entry([c.min(d), c.max(d)]).or_default() += length;
            }
        }
    }

    #[test]
    fn those_that_cost_least_are_joined_first() {
        let mut state = 7u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24)
        };
        for size in [2, 5, 9] {
            // Lengths are multiples of 1/2, so their sums are exact in any order.
            let place = |i: usize, j: usize, z: f64| [i as f64, j as f64, z];
            let heights: Vec<f64> = (0..(size + 1) * (size + 1)).map(|_| noise()).collect();
            let at = |i: usize, j: usize| place(i, j, heights[j * (size + 1) + i]);
            let mut cells = vec![];
            let mut joints = vec![];
            for j in 0..size {
                for i in 0..size {
                    let number = cells.len() as u32;
                    cells.push(Cell::from_triangle([at(i, j), at(i + 1, j), at(i + 1, j + 1)]));
                    cells.push(Cell::from_triangle([at(i, j), at(i + 1, j + 1), at(i, j + 1)]));
                    joints.push(Joint { between: [number, number + 1], length: 1.5 });
                    let right = (i + 1 < size).then_some([number, number + 3]);
                    let above = (j + 1 < size).then_some([number + 1, number + 2 * size as u32]);
                    joints.extend(
                        [right, above].into_iter().flatten().map(|b| Joint { between: b, length: 1.0 }),
                    );
                }
            }
            for most in [2, 5, 16, 1000] {
                assert_eq!(cluster(cells.clone(), &joints, most), brute(cells.clone(), &joints, most));
            }
        }
    }
}
