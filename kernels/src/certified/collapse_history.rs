//! Collapse history of a mesh, with selective undo.
//!
//! Each collapse joins two trees of input vertices. The active collapses form a forest, and each vertex of
//! the current mesh is the root of a tree. A triangle of the input still exists while its corners belong to
//! three different trees.
//!
//! A collapse changes the triangles around its survivor. It can be undone exactly if no later collapse
//! changed any of these triangles; later collapses that did are undone first. The dependencies between
//! collapses follow Xia and Varshney, "Dynamic view-dependent simplification for polygonal models", 1996.

use super::input_surface::InputSurface;
use crate::collapse::collapse_log::{CollapseSequence, RegionLog};

/// Marks the absence of a collapse.
const NO_COLLAPSE: u32 = u32::MAX;

/// One collapse, with its links in the forest.
#[derive(Clone, Copy)]
struct Collapse {
    survivor: u32,
    removed: u32,
    /// Previous collapses of the survivor and of the removed vertex.
    below: [u32; 2],
    /// The later collapse that has this one in `below`.
    above: u32,
}

/// Collapses of one round in one region.
struct CollapseBlock<const D: usize> {
    /// Index of the first collapse.
    first_collapse: u32,
    round: u32,
    survivor_points: Vec<[f64; D]>,
    /// Empty unless the collapse order is needed.
    priorities: Vec<f64>,
}

/// Collapses that led from the input to the current mesh.
pub struct History<'a, const D: usize> {
    original: &'a InputSurface<D>,
    /// In chronological order. Undone collapses stay in the list, but no vertex refers to them.
    collapses: Vec<Collapse>,
    kept: usize,
    /// Positions of the survivors and priorities, in the blocks in which they were recorded.
    blocks: Vec<CollapseBlock<D>>,
    /// Number of rounds recorded.
    round_count: u32,
    /// Keep priorities, so that [`Self::replay_sequence`] can be called.
    keeps_order: bool,
    /// By input vertex: the vertex of the current mesh that contains it.
    root: Vec<u32>,
    /// By vertex of the current mesh: the last collapse it survived.
    last: Vec<u32>,
    /// Collapses before this index cannot be undone.
    first_undoable: u32,
    permanent_count: usize,
}

/// A collapse that has not been undone.
pub struct ActiveCollapse<const D: usize> {
    /// Index in chronological order; undone collapses count.
    pub collapse_index: u32,
    pub removed: u32,
    pub survivor: u32,
    /// Position and attributes of the survivor after the collapse.
    pub point: [f64; D],
}

impl<'a, const D: usize> History<'a, D> {
    /// Create an empty history; `keeps_order` if [`Self::replay_sequence`] will be called.
    pub fn new(original: &'a InputSurface<D>, in_order: bool) -> Self {
        let vertices = original.points.len();
        Self {
            original,
            collapses: vec![],
            kept: 0,
            blocks: vec![],
            round_count: 0,
            keeps_order: in_order,
            root: (0..vertices as u32).collect(),
            last: vec![NO_COLLAPSE; vertices],
            first_undoable: 0,
            permanent_count: 0,
        }
    }

    /// Make all collapses so far permanent. Returns the index of the next collapse.
    pub fn make_permanent(&mut self) -> u32 {
        self.first_undoable = self.collapses.len() as u32;
        self.permanent_count = self.kept;
        self.first_undoable
    }

    /// Test if there is no collapse that could be undone.
    pub fn has_nothing_to_undo(&self) -> bool {
        self.kept == self.permanent_count
    }

    /// Append collapses, in vertex indices of the input.
    pub fn append(&mut self, logs: Vec<RegionLog<D>>) {
        let count = logs.iter().map(|log| log.merges.len()).sum();
        self.collapses.reserve_exact(count);
        self.kept += count;
        let mut into: Vec<u32> = (0..self.root.len() as u32).collect();
        for merge in logs.iter().rev().flat_map(|log| log.merges.iter().rev()) {
            into[merge.removed.index()] = into[merge.survivor.index()];
        }
        self.root.iter_mut().for_each(|root| *root = into[*root as usize]);
        let before = self.round_count;
        for log in logs {
            let round = before + log.round as u32;
            self.round_count = round + 1;
            let first = self.collapses.len() as u32;
            let priorities =
                if self.keeps_order { log.merges.iter().map(|m| m.priority).collect() } else { vec![] };
            self.blocks.push(CollapseBlock {
                first_collapse: first,
                round,
                survivor_points: log.survivor_points,
                priorities,
            });
            for merge in log.merges {
                let number = self.collapses.len() as u32;
                let (survivor, removed) = (merge.survivor.0, merge.removed.0);
                let below = [survivor, removed].map(|v| self.last[v as usize]);
                for child in below.into_iter().filter(|&child| child != NO_COLLAPSE) {
                    self.collapses[child as usize].above = number;
                }
                self.last[survivor as usize] = number;
                self.collapses.push(Collapse { survivor, removed, below, above: NO_COLLAPSE });
            }
        }
    }

    /// Return the vertex of the current mesh that contains an input vertex.
    pub fn root(&self, v: u32) -> u32 {
        self.root[v as usize]
    }

    /// Number of collapses that were not undone.
    pub fn active_count(&self) -> usize {
        self.kept
    }

    /// Return the position and attributes of a vertex of the current mesh.
    pub fn point(&self, v: u32) -> [f64; D] {
        match self.last[v as usize] {
            NO_COLLAPSE => self.original.points[v as usize],
            last => {
                let part = self.block_of(last);
                part.survivor_points[(last - part.first_collapse) as usize]
            }
        }
    }

    fn block_of(&self, collapse: u32) -> &CollapseBlock<D> {
        &self.blocks[self.blocks.partition_point(|part| part.first_collapse <= collapse) - 1]
    }

    /// Return the active collapses in replay order.
    ///
    /// Within a round the order is by priority: no other collapse of the round changed the mesh that one
    /// needs.
    pub fn replay_sequence(&self) -> CollapseSequence<D> {
        self.active_collapses().map(|kept| (kept.removed, kept.survivor, kept.point)).collect()
    }

    /// As [`Self::replay_sequence`], with the index of each collapse.
    pub fn active_collapses(&self) -> impl Iterator<Item = ActiveCollapse<D>> + '_ {
        let mut kept = vec![];
        let mut open: Vec<u32> = self
            .last
            .iter()
            .zip(&self.root)
            .zip(0..)
            .filter(|((_, root), v)| *root == v)
            .map(|((last, _), _)| *last)
            .collect();
        while let Some(number) = open.pop() {
            if number != NO_COLLAPSE {
                let part = self.block_of(number);
                let priority = part.priorities[(number - part.first_collapse) as usize];
                kept.push((part.round, priority, number));
                open.extend(self.collapses[number as usize].below);
            }
        }
        kept.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        kept.into_iter().map(|(_, _, number)| {
            let Collapse { removed, survivor, .. } = self.collapses[number as usize];
            let part = self.block_of(number);
            ActiveCollapse {
                collapse_index: number,
                removed,
                survivor,
                point: part.survivor_points[(number - part.first_collapse) as usize],
            }
        })
    }

    /// Map the corners of an input triangle to the current mesh; `None` if it has vanished.
    pub fn corners(&self, triangle: u32) -> Option<[u32; 3]> {
        let [a, b, c] = self.original.triangles[triangle as usize].map(|v| self.root[v as usize]);
        (a != b && b != c && c != a).then_some([a, b, c])
    }

    /// Visit every input vertex that a vertex of the current mesh contains.
    pub fn visit_members(&self, v: u32, visit: impl FnMut(u32)) {
        self.visit_tree(self.last[v as usize], v, visit);
    }

    /// Append the triangles around a vertex of the current mesh, each once.
    fn append_star(&self, v: u32, star: &mut Vec<u32>) {
        self.visit_members(v, |member| {
            star.extend(
                self.original.triangles_around(member).iter().filter(|&&t| self.corners(t).is_some()),
            );
        });
    }

    /// Find the last undoable collapse that changed a triangle of the current mesh.
    pub fn last_collapse_of_triangle(&self, corners: &[u32; 3]) -> Option<u32> {
        corners.iter().filter_map(|&v| self.last_collapse_of_vertex(v)).max()
    }

    /// Find the last undoable collapse that a vertex of the current mesh survived.
    pub fn last_collapse_of_vertex(&self, v: u32) -> Option<u32> {
        Some(self.last[v as usize]).filter(|&last| last != NO_COLLAPSE && last >= self.first_undoable)
    }

    /// Undo a collapse, after all later collapses that depend on it.
    ///
    /// `split` is called for each undone collapse with the triangles around its survivor before, and the
    /// triangles around both vertices after.
    pub fn undo(&mut self, collapse: u32, split: &mut impl FnMut(&Self, &[u32], &[u32])) {
        let (mut before, mut after) = (vec![], vec![]);
        let mut first = vec![collapse];
        while let Some(&number) = first.last() {
            let Collapse { survivor, removed, below, above } = self.collapses[number as usize];
            if above != NO_COLLAPSE {
                first.push(above);
                continue;
            }
            if self.last[survivor as usize] != number {
                // Undoing a later collapse has undone this one already.
                first.pop();
                continue;
            }
            before.clear();
            self.append_star(survivor, &mut before);
            let later =
                before.iter().filter_map(|&t| self.last_collapse_of_triangle(&self.corners(t)?)).max();
            if let Some(later) = later.filter(|&later| later > number) {
                first.push(later);
                continue;
            }
            let mut members = vec![];
            self.visit_tree(below[1], removed, |member| members.push(member));
            members.into_iter().for_each(|member| self.root[member as usize] = removed);
            for (v, child) in [survivor, removed].into_iter().zip(below) {
                self.last[v as usize] = child;
                if child != NO_COLLAPSE {
                    self.collapses[child as usize].above = NO_COLLAPSE;
                }
            }
            after.clear();
            self.append_star(survivor, &mut after);
            self.append_star(removed, &mut after);
            after.sort_unstable();
            after.dedup();
            self.kept -= 1;
            split(self, &before, &after);
            first.pop();
        }
    }

    /// Visit every input vertex below a collapse, or `v` alone if `collapse` is `NO_COLLAPSE`.
    fn visit_tree(&self, collapse: u32, v: u32, mut visit: impl FnMut(u32)) {
        let mut open = vec![(collapse, v)];
        while let Some((collapse, v)) = open.pop() {
            if collapse == NO_COLLAPSE {
                visit(v);
                continue;
            }
            let Collapse { survivor, removed, below, .. } = self.collapses[collapse as usize];
            open.extend([(below[0], survivor), (below[1], removed)]);
        }
    }
}
