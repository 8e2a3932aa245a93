//! Which collapses made a mesh what it is, and how to take some of them back.
//!
//! Each collapse joins two trees of vertices of the input, so that the collapses that stand form a forest and each
//! vertex of the current mesh is the root of a tree. A triangle of the input is still there while its corners belong to
//! three trees.
//!
//! A collapse changed the triangles around its survivor. It can be taken back, and the mesh there be what it was,
//! if none of these has been changed since; a later collapse that changed one is taken back first.
//! Such dependencies between collapses: Xia and Varshney, "Dynamic view-dependent simplification for polygonal models",
//! 1996.

use super::original::Original;
use crate::collapse::logs::{Log, Way};

/// No collapse.
const NONE: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Collapse {
    survivor: u32,
    removed: u32,
    /// The collapses that survivor and removed vertex had come from.
    below: [u32; 2],
    /// The collapse that one of them went into.
    above: u32,
}

/// Collapses of one round in one region.
struct Part<const D: usize> {
    /// The number of the first of them.
    first: u32,
    round: u32,
    path: Vec<[f64; D]>,
    /// Empty unless the way will be asked for.
    priorities: Vec<f64>,
}

pub struct History<'a, const D: usize> {
    original: &'a Original<D>,
    /// In the order of time. Those taken back are not reached from any vertex any more.
    collapses: Vec<Collapse>,
    kept: usize,
    /// Where each one's survivor went, in the pieces this was recorded in.
    parts: Vec<Part<D>>,
    /// Rounds so far.
    rounds: u32,
    /// Whether it will be asked for the way.
    in_order: bool,
    /// By vertex of the input: the vertex of the current mesh it is part of.
    root: Vec<u32>,
    /// By vertex of the current mesh: the last collapse it survived.
    last: Vec<u32>,
    /// Collapses before this one are for good.
    floor: u32,
    kept_for_good: usize,
}

/// A collapse that stands.
pub struct Kept<const D: usize> {
    /// Its place in the order of time, among those that were taken back as well.
    pub number: u32,
    pub removed: u32,
    pub survivor: u32,
    /// Where the survivor went.
    pub point: [f64; D],
}

impl<'a, const D: usize> History<'a, D> {
    /// The history of the input itself: nothing has happened. `in_order` if the way will be asked for.
    pub fn new(original: &'a Original<D>, in_order: bool) -> Self {
        let vertices = original.points.len();
        Self {
            original,
            collapses: vec![],
            kept: 0,
            parts: vec![],
            rounds: 0,
            in_order,
            root: (0..vertices as u32).collect(),
            last: vec![NONE; vertices],
            floor: 0,
            kept_for_good: 0,
        }
    }

    /// Nothing that has happened so far is taken back any more. Returns the number of the next collapse.
    pub fn settle(&mut self) -> u32 {
        self.floor = self.collapses.len() as u32;
        self.kept_for_good = self.kept;
        self.floor
    }

    /// Whether nothing has happened that may be taken back.
    pub fn is_settled(&self) -> bool {
        self.kept == self.kept_for_good
    }

    /// More collapses, in numbers of the input, with what their survivors became.
    pub fn append(&mut self, logs: Vec<Log<D>>) {
        let count = logs.iter().map(|log| log.merges.len()).sum();
        self.collapses.reserve_exact(count);
        self.kept += count;
        let mut into: Vec<u32> = (0..self.root.len() as u32).collect();
        for merge in logs.iter().rev().flat_map(|log| log.merges.iter().rev()) {
            into[merge.removed.index()] = into[merge.survivor.index()];
        }
        self.root.iter_mut().for_each(|root| *root = into[*root as usize]);
        let before = self.rounds;
        for log in logs {
            let round = before + log.round as u32;
            self.rounds = round + 1;
            let first = self.collapses.len() as u32;
            let priorities =
                if self.in_order { log.merges.iter().map(|m| m.priority).collect() } else { vec![] };
            self.parts.push(Part { first, round, path: log.path, priorities });
            for merge in log.merges {
                let number = self.collapses.len() as u32;
                let (survivor, removed) = (merge.survivor.0, merge.removed.0);
                let below = [survivor, removed].map(|v| self.last[v as usize]);
                for child in below.into_iter().filter(|&child| child != NONE) {
                    self.collapses[child as usize].above = number;
                }
                self.last[survivor as usize] = number;
                self.collapses.push(Collapse { survivor, removed, below, above: NONE });
            }
        }
    }

    /// The vertex of the current mesh that a vertex of the input is part of.
    pub fn root(&self, v: u32) -> u32 {
        self.root[v as usize]
    }

    /// Collapses that were not taken back.
    pub fn kept(&self) -> usize {
        self.kept
    }

    /// Where a vertex of the current mesh is.
    pub fn point(&self, v: u32) -> [f64; D] {
        match self.last[v as usize] {
            NONE => self.original.points[v as usize],
            last => {
                let part = self.part_of(last);
                part.path[(last - part.first) as usize]
            }
        }
    }

    fn part_of(&self, collapse: u32) -> &Part<D> {
        &self.parts[self.parts.partition_point(|part| part.first <= collapse) - 1]
    }

    /// The collapses that are kept, those of least priority first in each round: no other changed what they needed.
    pub fn way(&self) -> Way<D> {
        self.stand().map(|kept| (kept.removed, kept.survivor, kept.point)).collect()
    }

    /// As [`Self::way`], with their numbers.
    pub fn stand(&self) -> impl Iterator<Item = Kept<D>> + '_ {
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
            if number != NONE {
                let part = self.part_of(number);
                let priority = part.priorities[(number - part.first) as usize];
                kept.push((part.round, priority, number));
                open.extend(self.collapses[number as usize].below);
            }
        }
        kept.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        kept.into_iter().map(|(_, _, number)| {
            let Collapse { removed, survivor, .. } = self.collapses[number as usize];
            let part = self.part_of(number);
            Kept { number, removed, survivor, point: part.path[(number - part.first) as usize] }
        })
    }

    /// What a triangle of the input is in the current mesh, if it is still there.
    pub fn corners(&self, triangle: u32) -> Option<[u32; 3]> {
        let [a, b, c] = self.original.triangles[triangle as usize].map(|v| self.root[v as usize]);
        (a != b && b != c && c != a).then_some([a, b, c])
    }

    /// Visit every vertex of the input that is part of a vertex of the current mesh.
    pub fn visit_members(&self, v: u32, visit: impl FnMut(u32)) {
        self.visit_tree(self.last[v as usize], v, visit);
    }

    /// The triangles around a vertex of the current mesh, each once.
    fn star(&self, v: u32, star: &mut Vec<u32>) {
        self.visit_members(v, |member| {
            star.extend(self.original.around(member).iter().filter(|&&t| self.corners(t).is_some()));
        });
    }

    /// The last collapse that changed a triangle of the current mesh, if it may be taken back.
    pub fn latest(&self, corners: &[u32; 3]) -> Option<u32> {
        corners.iter().filter_map(|&v| self.last(v)).max()
    }

    /// The last collapse that a vertex of the current mesh survived, if it may be taken back.
    pub fn last(&self, v: u32) -> Option<u32> {
        Some(self.last[v as usize]).filter(|&last| last != NONE && last >= self.floor)
    }

    /// Take a collapse back, and before it all that need the mesh it made. `split` hears of each of them, with the
    /// triangles around its survivor before and those around both vertices after.
    pub fn undo(&mut self, collapse: u32, split: &mut impl FnMut(&Self, &[u32], &[u32])) {
        let (mut before, mut after) = (vec![], vec![]);
        let mut first = vec![collapse];
        while let Some(&number) = first.last() {
            let Collapse { survivor, removed, below, above } = self.collapses[number as usize];
            if above != NONE {
                first.push(above);
                continue;
            }
            if self.last[survivor as usize] != number {
                // Something else has taken it back already.
                first.pop();
                continue;
            }
            before.clear();
            self.star(survivor, &mut before);
            let later = before.iter().filter_map(|&t| self.latest(&self.corners(t)?)).max();
            if let Some(later) = later.filter(|&later| later > number) {
                first.push(later);
                continue;
            }
            let mut members = vec![];
            self.visit_tree(below[1], removed, |member| members.push(member));
            members.into_iter().for_each(|member| self.root[member as usize] = removed);
            for (v, child) in [survivor, removed].into_iter().zip(below) {
                self.last[v as usize] = child;
                if child != NONE {
                    self.collapses[child as usize].above = NONE;
                }
            }
            after.clear();
            self.star(survivor, &mut after);
            self.star(removed, &mut after);
            after.sort_unstable();
            after.dedup();
            self.kept -= 1;
            split(self, &before, &after);
            first.pop();
        }
    }

    /// Every vertex of the input below a collapse, or below none: `v` alone.
    fn visit_tree(&self, collapse: u32, v: u32, mut visit: impl FnMut(u32)) {
        let mut open = vec![(collapse, v)];
        while let Some((collapse, v)) = open.pop() {
            if collapse == NONE {
                visit(v);
                continue;
            }
            let Collapse { survivor, removed, below, .. } = self.collapses[collapse as usize];
            open.extend([(below[0], survivor), (below[1], removed)]);
        }
    }
}
