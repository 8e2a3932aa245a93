//! Construction of the levels of a hierarchy, from the input upwards.
//!
//! ```text
//! cells ← clusters of the input's triangles
//! repeat with a larger bound each time:
//!     simplify within the bound, from the last level on, with locked cell borders    certified
//!     bound each cell separately, against its part of the input                      certify
//!     stop if one cell is left and small enough
//!     join adjacent cells while the result is small enough
//! ```
//!
//! Every level continues with the input samples of the previous one and is proven against the input itself.
//! Bounds are never summed.

use super::clustering::{Cell, Joint, cluster, contract_joints, joined};
use super::initial_cells::cluster_triangles;
use super::vertex_forest::{LevelNodes, VertexForest, build_forest};
use crate::base::errors::KernelError;
use crate::base::geometry::{bounding_box, diagonal, position_of};
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::certified::input_surface::InputSurface;
use crate::certified::proof_cache::SeparatePartitions;
use crate::certified::simplify::{self, LoopResult, LoopState, run_loop};
use crate::certify::{self, Deviation, Verdict};
use crate::collapse::engine::Stop;
use crate::collapse::rounds::Goal;
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::connectivity::Connectivity;

/// No node.
pub const NONE: u32 = u32::MAX;

/// Largest error bound, relative to the bounding box diagonal. Larger bounds hardly remove triangles.
const MAX_BOUND_RATIO: f64 = 0.25;

/// A level that keeps more than this ratio of the triangles is the last, if a single cell is left.
const MAX_KEPT_RATIO: f64 = 0.9;

/// Maximum triangles per region. It is smaller than usual, because triangles of coarse levels have many
/// samples and threads would wait for each other.
const MAX_REGION_TRIANGLES: usize = 2048;

/// Options of [`build_hierarchy`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Error bound of the first level in metres, and the factor from one level to the next.
    pub first_bound: f64,
    pub bound_ratio: f64,
    /// Maximum triangles of a cell.
    pub max_cell_triangles: u32,
    /// Triangle count at which a single cell becomes the root.
    pub max_root_triangles: usize,
    /// True for vertices that stay on all levels; empty for none.
    pub locked: Vec<bool>,
    /// Simplification options; their shape bound is ignored.
    pub simplify: simplify::Options,
    /// Effort for bounding each node.
    pub bounding: certify::Options,
}

/// A cell on one level, with its mesh before and after that level.
#[derive(Clone, Debug)]
pub struct Node {
    pub level: u32,
    /// Parent node; [`NONE`] for the root.
    pub parent: u32,
    /// Proven two-sided deviation between the node's mesh after the level and its part of the input.
    pub bound: Deviation,
    /// Largest deviation observed there.
    pub attained: Deviation,
    /// Number of triangles after the level.
    pub triangle_count: usize,
}

/// Finished hierarchy; children come before their parents.
pub struct Hierarchy<const D: usize> {
    pub nodes: Vec<Node>,
    pub forest: VertexForest<D>,
    /// True if the caller stopped the work, so that levels are missing.
    pub stopped: bool,
    /// Number of triangles, of results and input, on levels that were accepted without proving the requested
    /// bound.
    pub unproven_count: usize,
}

/// Cells on the current level.
struct CellGroups {
    /// Cell of each input triangle; constant over all levels.
    of: Vec<u32>,
    cells: Vec<Cell>,
    joints: Vec<Joint>,
    /// Current group of each cell.
    group: Vec<u32>,
}

/// Build the hierarchy of a mesh.
///
/// # Errors
/// As [`crate::mesh::connectivity::Connectivity::from_triangles`], and [`KernelError::Interrupted`].
pub fn build_hierarchy<const D: usize, const K: usize>(
    points: Vec<[f64; D]>,
    triangles: Vec<[u32; 3]>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Hierarchy<D>, KernelError> {
    let goal = &Goal { region: goal.region.min(MAX_REGION_TRIANGLES), ..*goal };
    let whole = WholeMesh::<D, ()>::new(points, triangles, vec![])?;
    // Reject non-manifold input early.
    Connectivity::from_triangles_on(
        parallel::resolve_thread_count(goal.threads),
        whole.points.len(),
        &whole.triangles,
    )?;
    let original = InputSurface::new(whole.points, whole.triangles);
    let mut cells =
        CellGroups::of(&original, options.max_cell_triangles, parallel::resolve_thread_count(goal.threads));
    progress.check()?;
    let mut state = LoopState::of_input(&original, true)?;
    let mut nodes: Vec<Node> = vec![];
    let mut levels: Vec<LevelNodes> = vec![];
    let mut node_of = vec![NONE; cells.cells.len()];
    let mut bound = options.first_bound;
    let largest = MAX_BOUND_RATIO * diagonal(&bounding_box(original.points.iter().map(position_of)));
    let mut unproven = 0;
    let stopped = loop {
        let first = state.history.make_permanent();
        let before = cells.count_triangles(&state);
        let asked = Deviation { shape: bound, ..options.simplify.bounds };
        // The next level continues from this one, so it need not be finished to the end.
        let asked = simplify::Options { bounds: asked, until_exhausted: false, ..options.simplify.clone() };
        let locked = cells.flag_borders(&original, &options.locked);
        let part: Vec<u32> = cells.of.iter().map(|&cell| cells.group[cell as usize]).collect();
        let apart = SeparatePartitions { partition_index: &part, tolerances: &options.bounding };
        let reached = run_loop::<D, K>(&original, state, locked, Some(&apart), &asked, goal, progress)?;
        let LoopResult { state: next, ledger, proven, stop, passes } = reached;
        state = next;
        let made = cells.create_nodes(
            levels.len() as u32,
            &before,
            &cells.count_triangles(&state),
            &mut node_of,
            &mut nodes,
        );
        let is_made = |group: usize| made.iter().any(|&(g, _)| g == group);
        let left = passes.last().filter(|_| !proven).map_or(0, |pass| pass.unproven[0] + pass.unproven[1]);
        let proven = ledger.bound_partitions(&state.mesh, is_made, progress)?;
        // `bound_partitions` works harder and may prove groups that the simplifier could not.
        let is_missed = made.iter().any(|&(group, _)| proven[group].bound.shape > ledger.bounds().shape);
        unproven += if is_missed { left } else { 0 };
        for (group, node) in made {
            let Verdict { bound, attained, .. } = proven[group];
            // A parent's bound is at least the bounds of its children, so refining never increases the bound.
            let below = nodes.iter().filter(|n| n.parent == node);
            let bound = below.fold(bound, |most, child| most.max(child.bound));
            nodes[node as usize].bound = bound;
            nodes[node as usize].attained = attained;
        }
        levels.push(LevelNodes { first, node: node_of.clone() });
        let is_one = cells.group.iter().all(|&g| g == 0);
        let left = state.mesh.triangles.len();
        // Also stop if a larger bound hardly removes triangles: each floating component keeps a minimum.
        let light = left <= options.max_root_triangles
            || left as f64 > MAX_KEPT_RATIO * f64::from(before.iter().sum::<u32>());
        if is_one && (light || bound >= largest || stop == Stop::StoppedByCaller) {
            break stop == Stop::StoppedByCaller;
        }
        let counts = cells.count_triangles(&state);
        bound *= options.bound_ratio;
        if bound < largest && stop != Stop::StoppedByCaller {
            cells.join(&counts, options.max_cell_triangles);
        } else {
            // The mesh will not get smaller, so join everything to the root cell.
            cells.group.fill(0);
        }
    };
    renumber(&mut nodes, &mut levels);
    let forest = build_forest(&original, &state.history, &cells.of, &levels, nodes.len());
    for (node, coarse) in nodes.iter_mut().zip(&forest.surviving_triangles) {
        node.triangle_count = *coarse;
    }
    Ok(Hierarchy { nodes, forest, stopped, unproven_count: unproven })
}

/// Renumber nodes so that siblings are consecutive and parents are in the order of their children.
fn renumber(nodes: &mut Vec<Node>, levels: &mut [LevelNodes]) {
    let mut children: Vec<Vec<u32>> = vec![vec![]; nodes.len()];
    let mut order: Vec<u32> = vec![];
    for (n, node) in nodes.iter().enumerate().rev() {
        match node.parent {
            NONE => order.push(n as u32),
            parent => children[parent as usize].push(n as u32),
        }
    }
    let mut next = 0;
    while next < order.len() {
        order.extend(&children[order[next] as usize]);
        next += 1;
    }
    order.reverse();
    let mut number = vec![NONE; nodes.len()];
    (0..).zip(&order).for_each(|(new, &old)| number[old as usize] = new);
    let renamed = |&old: &u32| {
        let node = &nodes[old as usize];
        Node { parent: number.get(node.parent as usize).copied().unwrap_or(NONE), ..node.clone() }
    };
    *nodes = order.iter().map(renamed).collect();
    levels.iter_mut().flat_map(|level| &mut level.node).for_each(|n| *n = number[*n as usize]);
}

impl CellGroups {
    fn of<const D: usize>(original: &InputSurface<D>, most: u32, threads: usize) -> Self {
        let (of, cells, joints) = cluster_triangles(original, most, threads);
        let group = (0..cells.len() as u32).collect();
        Self { of, cells, joints, group }
    }

    /// Flag input vertices between triangles of different groups, and vertices locked by the caller.
    fn flag_borders<const D: usize>(&self, original: &InputSurface<D>, locked: &[bool]) -> Vec<bool> {
        let mut seen = vec![NONE; original.points.len()];
        let mut is_border = locked.to_vec();
        is_border.resize(original.points.len(), false);
        for (corners, &cell) in original.triangles.iter().zip(&self.of) {
            let group = self.group[cell as usize];
            for &v in corners {
                match seen[v as usize] {
                    NONE => seen[v as usize] = group,
                    other => is_border[v as usize] |= other != group,
                }
            }
        }
        is_border
    }

    /// Count the triangles of each group in the current mesh.
    fn count_triangles<const D: usize>(&self, state: &LoopState<'_, D>) -> Vec<u32> {
        let mut counts = vec![0; self.group.iter().max().map_or(0, |&g| g as usize + 1)];
        let group = |&t: &u32| self.group[self.of[t as usize] as usize];
        state.mesh.triangle_source.iter().for_each(|t| counts[group(t) as usize] += 1);
        counts
    }

    /// Create a node for each group that was joined or simplified on this level. Returns the groups and their
    /// nodes.
    fn create_nodes(
        &self,
        level: u32,
        before: &[u32],
        after: &[u32],
        node_of: &mut [u32],
        nodes: &mut Vec<Node>,
    ) -> Vec<(usize, u32)> {
        let mut members: Vec<Vec<u32>> = vec![vec![]; before.len()];
        (0..).zip(&self.group).for_each(|(cell, &g)| members[g as usize].push(cell));
        let mut made = vec![];
        for (g, members) in members.iter().enumerate() {
            let below: Vec<u32> = members.iter().map(|&cell| node_of[cell as usize]).collect();
            let same = below.iter().all(|&node| node == below[0]);
            if same && below[0] != NONE && before[g] == after[g] {
                continue;
            }
            let number = nodes.len() as u32;
            for node in below.into_iter().filter(|&node| node != NONE) {
                nodes[node as usize].parent = number;
            }
            members.iter().for_each(|&cell| node_of[cell as usize] = number);
            let (bound, attained) = Default::default();
            nodes.push(Node { level, parent: NONE, bound, attained, triangle_count: 0 });
            made.push((g, number));
        }
        made
    }

    /// Join adjacent groups while the result has at most `max_cell_triangles` triangles.
    fn join(&mut self, counts: &[u32], most: u32) {
        let mut groups = joined(&self.cells, &self.joints, &self.group);
        groups.iter_mut().zip(counts).for_each(|(cell, &count)| cell.count = count);
        let next = cluster(groups, &contract_joints(&self.joints, &self.group), most);
        self.group.iter_mut().for_each(|g| *g = next[*g as usize]);
    }
}
