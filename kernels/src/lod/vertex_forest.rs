//! Vertex forest of a hierarchy: the collapses in reverse, as vertex splits.
//!
//! A collapse replaces two vertices by one. If that one is at the survivor's position, it is the survivor.
//! This holds for all border vertices, which several nodes share. Otherwise it is a new vertex. The vertices
//! of all levels thus form a forest. They are numbered backwards: first the vertices that no collapse
//! consumed, then the vertices consumed by the last collapse, and so on. Consequently:
//!
//! * after some splits, the mesh has the vertices below some index, except those replaced by these splits;
//! * the current vertex of a corner is found by following `origin` until the index is below that limit.
//!
//! This is the total-ordered mesh of Wang, Lu and Pan (2012), which follows the edge collapse list until the
//! index is below the vertex count. Here the collapses of each node are consecutive, and parents come before
//! children. The rule therefore holds for any front of the tree.

use crate::certified::collapse_history::{ActiveCollapse, History};
use crate::certified::input_surface::InputSurface;

/// Not consumed, or not removed.
const NEVER: u32 = u32::MAX;

/// Assignment of cells to nodes on one level.
pub struct LevelNodes {
    /// Number of the level's first collapse.
    pub first: u32,
    /// Node of each cell of the input.
    pub node: Vec<u32>,
}

/// Vertices and triangles of a hierarchy, in the order of its nodes from last to first.
pub struct VertexForest<const D: usize> {
    /// Number of vertices that are never consumed; they have the lowest indices.
    pub roots: usize,
    pub points: Vec<[f64; D]>,
    /// Vertex that replaces each vertex from `roots` on.
    pub origin: Vec<u32>,
    /// Number of vertices that each split adds, 1 or 2.
    pub vertices_per_split: Vec<u8>,
    /// Number of triangles that each split adds, 0 to 2.
    pub triangles_per_split: Vec<u8>,
    /// Splits of node n, counted from the last node: `splits[n]..splits[n + 1]`.
    pub splits: Vec<usize>,
    /// Mesh of each node before its level: first the triangles that survive the level, then those added by
    /// each split.
    pub triangles: Vec<[u32; 3]>,
    pub starts: Vec<usize>,
    /// Input triangle of each triangle.
    pub source: Vec<u32>,
    /// Number of surviving triangles of each node, counted from the first node.
    pub surviving_triangles: Vec<usize>,
}

/// History of the vertices: input vertices first, then those created by collapses.
struct VertexHistory<const D: usize> {
    points: Vec<[f64; D]>,
    /// Collapse that consumed each vertex.
    consumed_by: Vec<u32>,
    /// Vertex that replaced each consumed vertex.
    replaced_by: Vec<u32>,
    collapses: u32,
}

impl<const D: usize> VertexHistory<D> {
    /// Find the collapse that merges two vertices, if it comes before `end`.
    fn find_merge(&self, mut x: u32, mut y: u32, end: u32) -> u32 {
        loop {
            let (by_x, by_y) = (self.consumed_by[x as usize], self.consumed_by[y as usize]);
            let first = by_x.min(by_y);
            if first >= end {
                return NEVER;
            }
            if by_x == first {
                x = self.replaced_by[x as usize];
            }
            if by_y == first {
                y = self.replaced_by[y as usize];
            }
            if x == y {
                return first;
            }
        }
    }

    /// Find the current replacement of a vertex just before collapse `end`.
    fn find_current(&self, mut x: u32, end: u32) -> u32 {
        while self.consumed_by[x as usize] < end {
            x = self.replaced_by[x as usize];
        }
        x
    }
}

/// Build the forest of all `levels`. `cell` holds the cell of each input triangle.
pub fn build_forest<const D: usize>(
    original: &InputSurface<D>,
    history: &History<'_, D>,
    cell: &[u32],
    levels: &[LevelNodes],
    nodes: usize,
) -> VertexForest<D> {
    let level_of = |number: u32| levels.partition_point(|level| level.first <= number) - 1;
    let mut kept: Vec<(u32, ActiveCollapse<D>)> = history
        .active_collapses()
        .map(|kept| {
            let inside = original.triangles_around(kept.removed)[0];
            (levels[level_of(kept.collapse_index)].node[cell[inside as usize] as usize], kept)
        })
        .collect();
    kept.sort_by_key(|(node, _)| *node);

    let mut now: Vec<u32> = (0..original.points.len() as u32).collect();
    let mut merged = VertexHistory {
        points: original.points.clone(),
        consumed_by: vec![NEVER; now.len()],
        replaced_by: vec![NEVER; now.len()],
        collapses: kept.len() as u32,
    };
    for (i, (_, ActiveCollapse { removed, survivor, point, .. })) in (0..).zip(&kept) {
        let [gone, mut stays] = [removed, survivor].map(|&v| now[v as usize]);
        if merged.points[stays as usize] != *point {
            let made = merged.points.len() as u32;
            merged.points.push(*point);
            merged.consumed_by.push(NEVER);
            merged.replaced_by.push(NEVER);
            merged.consumed_by[stays as usize] = i;
            merged.replaced_by[stays as usize] = made;
            now[*survivor as usize] = made;
            stays = made;
        }
        merged.consumed_by[gone as usize] = i;
        merged.replaced_by[gone as usize] = stays;
    }
    // First collapse of each node, plus the total.
    let mut first = vec![kept.len() as u32; nodes + 1];
    for (i, (node, _)) in kept.iter().enumerate().rev() {
        first[*node as usize] = i as u32;
    }
    for node in (0..nodes).rev() {
        first[node] = first[node].min(first[node + 1]);
    }

    let alive = list_node_triangles(original, &merged, cell, levels, &first);
    number_backwards(&merged, &first, alive)
}

/// Triangle of a node's mesh before its level.
struct NodeTriangle {
    /// Collapse of that node that removes the triangle; [`NEVER`] if it survives.
    removed_by: u32,
    source: u32,
    corners: [u32; 3],
}

/// List the triangles of each node's mesh before its level.
fn list_node_triangles<const D: usize>(
    original: &InputSurface<D>,
    merged: &VertexHistory<D>,
    cell: &[u32],
    levels: &[LevelNodes],
    first: &[u32],
) -> Vec<Vec<NodeTriangle>> {
    let mut nodes: Vec<Vec<NodeTriangle>> = (1..first.len()).map(|_| vec![]).collect();
    let mut alive: Vec<(u32, [u32; 3])> = (0..).zip(original.triangles.iter().copied()).collect();
    for (number, level) in levels.iter().enumerate() {
        alive.retain_mut(|(source, corners)| {
            let in_cell = cell[*source as usize] as usize;
            let node = level.node[in_cell];
            if number > 0 && levels[number - 1].node[in_cell] == node {
                return true;
            }
            let end = first[node as usize + 1];
            let [a, b, c] = *corners;
            let death = merged
                .find_merge(a, b, end)
                .min(merged.find_merge(b, c, end))
                .min(merged.find_merge(c, a, end));
            nodes[node as usize].push(NodeTriangle { removed_by: death, source: *source, corners: *corners });
            *corners = corners.map(|v| merged.find_current(v, end));
            death == NEVER
        });
    }
    nodes
}

/// Renumber vertices, splits and triangles from last to first.
fn number_backwards<const D: usize>(
    merged: &VertexHistory<D>,
    first: &[u32],
    mut alive: Vec<Vec<NodeTriangle>>,
) -> VertexForest<D> {
    let all = merged.collapses as usize;
    let mut is_left = vec![false; merged.points.len()];
    if let Some(root) = alive.last() {
        let left = root.iter().filter(|t| t.removed_by == NEVER).flat_map(|t| t.corners);
        left.for_each(|v| is_left[merged.find_current(v, NEVER) as usize] = true);
    }
    // Remaining vertices first, then consumed ones from the last collapse on. Unused vertices are dropped.
    let mut order: Vec<u32> = (0..merged.points.len() as u32)
        .filter(|&v| is_left[v as usize] || merged.consumed_by[v as usize] != NEVER)
        .collect();
    order.sort_by_key(|&v| std::cmp::Reverse(merged.consumed_by[v as usize]));
    let mut number = vec![NEVER; merged.points.len()];
    (0..).zip(&order).for_each(|(n, &v)| number[v as usize] = n);
    let roots = order.partition_point(|&v| merged.consumed_by[v as usize] == NEVER);
    let mut made = vec![0; all];
    order[roots..].iter().for_each(|&v| made[all - 1 - merged.consumed_by[v as usize] as usize] += 1);

    let mut forest = VertexForest {
        roots,
        points: order.iter().map(|&v| merged.points[v as usize]).collect(),
        origin: order[roots..].iter().map(|&v| number[merged.replaced_by[v as usize] as usize]).collect(),
        vertices_per_split: made,
        triangles_per_split: vec![0; all],
        splits: vec![0],
        triangles: vec![],
        starts: vec![0],
        source: vec![],
        surviving_triangles: alive
            .iter()
            .map(|node| node.iter().filter(|t| t.removed_by == NEVER).count())
            .collect(),
    };
    for (node, triangles) in alive.iter_mut().enumerate().rev() {
        triangles.sort_unstable_by_key(|t| (std::cmp::Reverse(t.removed_by), t.source));
        for t in triangles.iter() {
            if t.removed_by != NEVER {
                forest.triangles_per_split[all - 1 - t.removed_by as usize] += 1;
            }
            forest.triangles.push(t.corners.map(|v| number[v as usize]));
            forest.source.push(t.source);
        }
        forest.starts.push(forest.triangles.len());
        forest.splits.push(all - first[node] as usize);
    }
    forest
}
