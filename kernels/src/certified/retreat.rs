//! Going back to where a proof may succeed: collapses around its failures are undone, and the mesh that is left is made
//! ready to be simplified again.

use super::history::History;
use super::ledger::Open;
use super::watched::Watched;
use crate::original::Original;
use crate::patch::{Held, Whole};
use crate::tracked::{Bound, Lists};

/// Collapses of a vertex that are taken back at most in one turn, unless they are all.
const DEEPEST: usize = 8;

pub struct Retreat<'a, const D: usize> {
    original: &'a Original<D>,
    history: History<'a, D>,
    watched: Watched,
    /// Triangles that are not what they were, or not there any more.
    touched: Vec<u32>,
}

impl<'a, const D: usize> Retreat<'a, D> {
    pub fn new(original: &'a Original<D>, mut history: History<'a, D>, watched: Watched) -> Self {
        history.settle();
        Self { original, history, watched, touched: vec![] }
    }

    /// Samples of the triangles of the result without a proof, or of those beside one that has none, and corners of
    /// those of the input; each once.
    pub fn samples_around(&self, mesh: &Whole<D, Bound>, open: &Open) -> Vec<u32> {
        let mut around: Vec<u32> =
            open.of_input.iter().flat_map(|&t| self.original.triangles[t as usize]).collect();
        let mut bare = vec![];
        for &i in &open.of_result {
            let before = around.len();
            around.extend(self.watched.of(mesh.triangle_source[i as usize]));
            if around.len() == before {
                bare.extend(mesh.triangles[i as usize]);
            }
        }
        if !bare.is_empty() {
            let mut is_bare = vec![false; mesh.points.len()];
            bare.into_iter().for_each(|v| is_bare[v as usize] = true);
            for (corners, &source) in mesh.triangles.iter().zip(&mesh.triangle_source) {
                if corners.iter().any(|&v| is_bare[v as usize]) {
                    around.extend(self.watched.of(source));
                }
            }
        }
        around.sort_unstable();
        around.dedup();
        around
    }

    /// Take back what made the triangles without a proof, and the triangles that the input's lie at; more in a later turn.
    pub fn take_back(&mut self, mesh: &Whole<D, Bound>, open: &Open, turn: usize) {
        let of_result = open.of_result.iter().map(|&i| mesh.triangle_source[i as usize]);
        let corners = open.of_input.iter().flat_map(|&t| self.original.triangles[t as usize]);
        let mut made: Vec<u32> = of_result.chain(corners.filter_map(|v| self.watched.owner(v))).collect();
        made.sort_unstable();
        made.dedup();
        let made: Vec<[u32; 3]> = made.into_iter().filter_map(|t| self.history.corners(t)).collect();
        for corners in &made {
            if let Some(collapse) = self.history.latest(corners) {
                self.undo(collapse);
            }
        }
        for &v in made.iter().flatten() {
            for _ in 1..turn.min(DEEPEST) {
                let Some(collapse) = self.history.last(v) else { break };
                self.undo(collapse);
            }
        }
    }

    /// Bring vertices of the input back and hold them there.
    pub fn hold(&mut self, vertices: &[u32], fixed: &mut Vec<bool>) {
        if vertices.is_empty() {
            return;
        }
        fixed.resize(self.original.points.len(), false);
        for &v in vertices {
            fixed[v as usize] = true;
            while let Some(collapse) = self.history.last(self.history.root(v)) {
                self.undo(collapse);
            }
        }
    }

    fn undo(&mut self, collapse: u32) {
        let Self { original, history, watched, touched } = self;
        history.undo(collapse, &mut |history, before, after| {
            watched.share_out(original, history, before, after);
            touched.extend_from_slice(before);
            touched.extend_from_slice(after);
        });
    }

    /// The mesh there is now, the samples of its triangles, and what led to it. `before` is what it was.
    pub fn mesh(
        mut self,
        before: Whole<D, Bound>,
        fixed: &[bool],
    ) -> (Whole<D, Bound>, Lists, History<'a, D>) {
        self.touched.sort_unstable();
        self.touched.dedup();
        let corners = |t: u32| self.history.corners(t).map(|corners| (t, corners));
        let new: Vec<(u32, [u32; 3])> = self.touched.iter().filter_map(|&t| corners(t)).collect();
        // What was refused may be allowed beside them.
        let mut near = vec![false; self.original.points.len()];
        new.iter().flat_map(|(_, corners)| corners).for_each(|&v| near[v as usize] = true);

        let Whole { triangles, triangle_source, vertex_source, held, .. } = before;
        let known = held.len() == triangles.len();
        let mut next = Whole {
            points: vec![],
            triangles: Vec::with_capacity(triangles.len() + new.len()),
            triangle_source: Vec::with_capacity(triangles.len() + new.len()),
            vertex_source: vec![],
            fixed: vec![],
            held: Vec::with_capacity(triangles.len() + new.len()),
        };
        for (i, (corners, source)) in triangles.into_iter().zip(triangle_source).enumerate() {
            if self.touched.binary_search(&source).is_ok() {
                continue;
            }
            let corners = corners.map(|v| vertex_source[v as usize]);
            let open = |side: usize| near[corners[side] as usize] || near[corners[(side + 1) % 3] as usize];
            let held: Held<Bound> = if known { held[i] } else { [None; 3] };
            next.held.push(std::array::from_fn(|side| held[side].filter(|_| !open(side))));
            next.triangles.push(corners);
            next.triangle_source.push(source);
        }
        for (source, corners) in new {
            next.held.push([None; 3]);
            next.triangles.push(corners);
            next.triangle_source.push(source);
        }
        next.vertex_source = next.triangles.iter().flatten().copied().collect();
        next.vertex_source.sort_unstable();
        next.vertex_source.dedup();
        let mut number = vec![0; self.original.points.len()];
        next.vertex_source.iter().zip(0..).for_each(|(&v, i)| number[v as usize] = i);
        next.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        next.points = next.vertex_source.iter().map(|&v| self.history.point(v)).collect();
        if !fixed.is_empty() {
            next.fixed = next.vertex_source.iter().map(|&v| fixed[v as usize]).collect();
        }
        let lists = self.watched.lists(&next.triangle_source);
        (next, lists, self.history)
    }
}
