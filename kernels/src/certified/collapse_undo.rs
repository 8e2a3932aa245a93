//! Undo of the collapses around failed proofs.

use super::collapse_history::History;
use super::input_surface::InputSurface;
use super::proof_cache::UnprovenSet;
use super::sample_owners::SampleOwners;
use super::sample_tracker::{LimitKind, SampleLists};
use crate::collapse::whole_mesh::{CornerRefusals, WholeMesh};

/// A mesh in the process of undoing collapses.
pub struct CollapseUndo<'a, const D: usize> {
    original: &'a InputSurface<D>,
    history: History<'a, D>,
    sample_owners: SampleOwners,
    /// Triangles whose shape changed or that reappeared.
    touched: Vec<u32>,
}

impl<'a, const D: usize> CollapseUndo<'a, D> {
    pub fn new(original: &'a InputSurface<D>, history: History<'a, D>, watched: SampleOwners) -> Self {
        Self { original, history, sample_owners: watched, touched: vec![] }
    }

    /// Collect the samples around unproven triangles, sorted, each once.
    ///
    /// These are the corners of unproven input triangles and the samples of unproven mesh triangles. A mesh
    /// triangle without samples contributes its corners and the samples of its neighbours.
    pub fn collect_samples_around(&self, mesh: &WholeMesh<D, LimitKind>, open: &UnprovenSet) -> Vec<u32> {
        let mut around: Vec<u32> =
            open.input_triangles.iter().flat_map(|&t| self.original.triangles[t as usize]).collect();
        let mut bare = vec![];
        for &t in &open.mesh_triangles {
            let before = around.len();
            around.extend(self.sample_owners.samples_of(t));
            if around.len() == before {
                bare.extend(self.history.corners(t).into_iter().flatten());
            }
        }
        if !bare.is_empty() {
            around.extend_from_slice(&bare);
            let mut is_bare = vec![false; self.original.points.len()];
            bare.into_iter().for_each(|v| is_bare[v as usize] = true);
            for (corners, &t) in mesh.triangles.iter().zip(&mesh.triangle_source) {
                if corners.iter().any(|&v| is_bare[mesh.vertex_source[v as usize] as usize]) {
                    around.extend(self.sample_owners.samples_of(t));
                }
            }
        }
        around.sort_unstable();
        around.dedup();
        around
    }

    /// Select the unproven triangles where proofs failed at least `times` times.
    ///
    /// `failures` counts failed proofs by input vertex.
    pub fn repeatedly_failed(&self, open: &UnprovenSet, failures: &[u8], times: u8) -> UnprovenSet {
        let often = |v: u32| failures[v as usize] >= times;
        let corners = |t: u32| self.history.corners(t).into_iter().flatten();
        let of_result = open.mesh_triangles.iter().copied();
        let of_input = open.input_triangles.iter().zip(&open.within_reach);
        let stubborn = of_input.filter(|(t, _)| self.original.triangles[**t as usize].into_iter().any(often));
        let (of_input, within_reach) = stubborn.map(|(t, reach)| (*t, reach.clone())).unzip();
        let of_result =
            of_result.filter(|&t| self.sample_owners.samples_of(t).chain(corners(t)).any(often)).collect();
        UnprovenSet { mesh_triangles: of_result, input_triangles: of_input, within_reach }
    }

    /// Undo the collapses that produced unproven triangles.
    ///
    /// For a mesh triangle this is the last collapse that changed it. For an input triangle it is the latest
    /// such collapse of the mesh triangles that own its corners, because the fewest later collapses depend on
    /// it. After more than two failures (`failures`, by input vertex), the last collapse of every mesh
    /// triangle within reach is undone.
    ///
    /// Returns the triangles around which nothing can be undone: they cannot be proven.
    pub fn undo_unproven(&mut self, open: &UnprovenSet, failures: &[u8]) -> Vec<u32> {
        let latest = |t: &u32| {
            self.history.corners(*t).and_then(|corners| self.history.last_collapse_of_triangle(&corners))
        };
        let (mut collapses, mut hopeless) = (vec![], vec![]);
        for &t in &open.mesh_triangles {
            match latest(&t) {
                Some(collapse) => collapses.push(collapse),
                None => hopeless.push(t),
            }
        }
        for (&t, within_reach) in open.input_triangles.iter().zip(&open.within_reach) {
            let corners = self.original.triangles[t as usize];
            let owners = corners.iter().filter_map(|&v| self.sample_owners.owner(v));
            let one = owners.filter_map(|t| latest(&t)).max();
            collapses.extend(one);
            if one.is_none() || corners.iter().any(|&v| failures[v as usize] > 2) {
                let before = collapses.len();
                collapses.extend(within_reach.iter().filter_map(latest));
                if collapses.len() == before {
                    hopeless.push(t);
                }
            }
        }
        collapses.sort_unstable();
        collapses.dedup();
        collapses.into_iter().rev().for_each(|collapse| self.undo(collapse));
        hopeless
    }

    /// Collect the input vertices around unproven triangles, sorted, each once.
    ///
    /// Includes the vertices and samples of the mesh triangles within reach.
    pub fn collect_vertices_around(&self, open: &UnprovenSet) -> Vec<u32> {
        let mut around: Vec<u32> =
            open.input_triangles.iter().flat_map(|&t| self.original.triangles[t as usize]).collect();
        for &t in open.mesh_triangles.iter().chain(open.within_reach.iter().flatten()) {
            around.extend(self.original.triangles[t as usize]);
            around.extend(self.sample_owners.samples_of(t));
            around.extend(self.history.corners(t).into_iter().flatten());
        }
        around.sort_unstable();
        around.dedup();
        around
    }

    /// Undo the last collapse of every vertex of the mesh that contains one of these input vertices.
    pub fn refine(&mut self, vertices: &[u32]) {
        for root in self.find_roots(vertices) {
            if let Some(collapse) = self.history.last_collapse_of_vertex(root) {
                self.undo(collapse);
            }
        }
    }

    /// Lock every vertex of the mesh that contains one of these input vertices.
    pub fn lock(&self, vertices: &[u32], locked: &mut Vec<bool>) {
        if vertices.is_empty() {
            return;
        }
        locked.resize(self.original.points.len(), false);
        self.find_roots(vertices).into_iter().for_each(|root| locked[root as usize] = true);
    }

    /// Find the vertices of the mesh that contain input vertices, sorted, each once.
    fn find_roots(&self, vertices: &[u32]) -> Vec<u32> {
        let mut roots: Vec<u32> = vertices.iter().map(|&v| self.history.root(v)).collect();
        roots.sort_unstable();
        roots.dedup();
        roots
    }

    /// Restore input vertices and lock them.
    pub fn restore_and_lock(&mut self, vertices: &[u32], locked: &mut Vec<bool>) {
        if vertices.is_empty() {
            return;
        }
        locked.resize(self.original.points.len(), false);
        for &v in vertices {
            locked[v as usize] = true;
            while let Some(collapse) = self.history.last_collapse_of_vertex(self.history.root(v)) {
                self.undo(collapse);
            }
        }
    }

    fn undo(&mut self, collapse: u32) {
        let Self { original, history, sample_owners: watched, touched } = self;
        history.undo(collapse, &mut |history, before, after| {
            watched.reassign(original, history, before, after);
            touched.extend_from_slice(before);
            touched.extend_from_slice(after);
        });
    }

    /// Build the mesh after the undo, its sample lists and its history. `before` is the mesh before the undo.
    pub fn into_state(
        mut self,
        before: WholeMesh<D, LimitKind>,
        locked: &[bool],
    ) -> (WholeMesh<D, LimitKind>, SampleLists, History<'a, D>) {
        self.touched.sort_unstable();
        self.touched.dedup();
        let corners = |t: u32| self.history.corners(t).map(|corners| (t, corners));
        let new: Vec<(u32, [u32; 3])> = self.touched.iter().filter_map(|&t| corners(t)).collect();
        // Edges next to a changed triangle may be legal now: forget their refusals.
        let mut near = vec![false; self.original.points.len()];
        new.iter().flat_map(|(_, corners)| corners).for_each(|&v| near[v as usize] = true);

        let WholeMesh { triangles, triangle_source, vertex_source, refused, .. } = before;
        let known = refused.len() == triangles.len();
        let mut next = WholeMesh {
            points: vec![],
            triangles: Vec::with_capacity(triangles.len() + new.len()),
            triangle_source: Vec::with_capacity(triangles.len() + new.len()),
            vertex_source: vec![],
            locked: vec![],
            refused: Vec::with_capacity(triangles.len() + new.len()),
        };
        for (i, (corners, source)) in triangles.into_iter().zip(triangle_source).enumerate() {
            if self.touched.binary_search(&source).is_ok() {
                continue;
            }
            let corners = corners.map(|v| vertex_source[v as usize]);
            let open = |side: usize| near[corners[side] as usize] || near[corners[(side + 1) % 3] as usize];
            let refused: CornerRefusals<LimitKind> = if known { refused[i] } else { [None; 3] };
            next.refused.push(std::array::from_fn(|side| refused[side].filter(|_| !open(side))));
            next.triangles.push(corners);
            next.triangle_source.push(source);
        }
        for (source, corners) in new {
            next.refused.push([None; 3]);
            next.triangles.push(corners);
            next.triangle_source.push(source);
        }
        let mut number = vec![0u32; self.original.points.len()];
        next.triangles.iter().flatten().for_each(|&v| number[v as usize] = 1);
        for (v, number) in (0..).zip(&mut number).filter(|(_, number)| **number == 1) {
            *number = next.vertex_source.len() as u32;
            next.vertex_source.push(v);
        }
        next.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        next.points = next.vertex_source.iter().map(|&v| self.history.point(v)).collect();
        if !locked.is_empty() {
            next.locked = next.vertex_source.iter().map(|&v| locked[v as usize]).collect();
        }
        let lists = self.sample_owners.to_lists(&next.triangle_source);
        (next, lists, self.history)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_failures_are_selected_by_count() {
        // A strip of four triangles.
        let points: Vec<[f64; 3]> = (0..6).map(|i| [f64::from(i), f64::from(i % 2), 0.0]).collect();
        let triangles = vec![[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]];
        let original = InputSurface::new(points, triangles);
        let watched = SampleOwners::new(&original, &[0, 1, 2, 3], &SampleLists::of_input(&original));
        let retreat = CollapseUndo::new(&original, History::new(&original, false), watched);
        let open = UnprovenSet {
            mesh_triangles: vec![0, 3],
            input_triangles: vec![0, 2],
            within_reach: vec![vec![1], vec![2, 3]],
        };
        let failures = [0, 2, 2, 0, 0, 5];
        let stubborn = |times| {
            let found = retreat.repeatedly_failed(&open, &failures, times);
            (found.mesh_triangles, found.input_triangles, found.within_reach)
        };
        assert_eq!(stubborn(2), (vec![0, 3], vec![0, 2], vec![vec![1], vec![2, 3]]));
        assert_eq!(stubborn(3), (vec![3], vec![], vec![]));
        assert_eq!(stubborn(6), (vec![], vec![], vec![]));
    }
}
