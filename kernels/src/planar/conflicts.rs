//! Conflicts between patches that make an assembly non-manifold: repeated edges and pairs of identical
//! triangles.

use super::assembly_state::{Assembly, BATCH, EdgeKind, ResultEdge, sort_pair};
use super::patch_triangulation::{MAX_ATTEMPTS, Outcome};
use crate::base::errors::KernelError;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::parallel;
use crate::mesh::connectivity::Connectivity;

impl<const D: usize> Assembly<'_, D> {
    /// Resolve conflicts. Returns the patches that must be triangulated again.
    pub(super) fn resolve_conflicts(&mut self) -> Vec<u32> {
        let edges = self.gather_edges();
        let mut again = vec![];
        for same in edges.chunk_by(|e, f| e.0 == f.0) {
            // The first edge may stay; it occurs once from each side.
            let first = (same[0].1, same[0].2);
            for edge in same.iter().filter(|e| (e.1, e.2) != first) {
                self.resolve_edge(edge, &mut again);
            }
        }
        self.edges = edges;
        self.forbidden.sort_unstable();
        self.forbidden.dedup();
        if again.is_empty() {
            self.check_connectivity(&mut again);
        }
        self.sort_unique(again)
    }

    /// Gather all edges, sorted. Edges of unchanged patches are reused.
    fn gather_edges(&mut self) -> Vec<ResultEdge> {
        let count = self.has_changed.len();
        let changed: Vec<u32> = (0..count as u32).filter(|&p| self.has_changed[p as usize]).collect();
        let mut fresh: Vec<ResultEdge> = parallel::map(
            changed.len().div_ceil(BATCH),
            self.options.threads,
            || (),
            |_, batch| {
                let end = changed.len().min((batch + 1) * BATCH);
                changed[batch * BATCH..end].iter().flat_map(|&p| self.edges(p)).collect::<Vec<_>>()
            },
        )
        .concat();
        fresh.sort_unstable();
        let mut edges = std::mem::take(&mut self.edges);
        edges.retain(|edge| !self.has_changed[edge.3 as usize]);
        edges.extend(fresh);
        // The stable sort merges two sorted runs in linear time.
        edges.sort();
        self.has_changed.fill(false);
        edges
    }

    fn edges(&self, patch: u32) -> Vec<ResultEdge> {
        let connectivity = &self.mesh.connectivity;
        let mut edges = vec![];
        if self.keeps_triangles[patch as usize] {
            for &t in self.members(patch) {
                for h in (3 * t..3 * t + 3).map(HalfedgeId) {
                    let ends = sort_pair(connectivity.origin(h), connectivity.target(h));
                    edges.push((ends, EdgeKind::Input, connectivity.edge(h).0, patch));
                }
            }
            return edges;
        }
        let polygon = self.polygon(patch);
        let mut border: Vec<[VertexId; 2]> = vec![];
        for (c, corner) in polygon.corners.iter().enumerate() {
            let ends = sort_pair(corner.vertex, polygon.corners[corner.next].vertex);
            let (mut length, mut least) = (0, u32::MAX);
            for h in polygon.chord_edges(c) {
                (length, least) = (length + 1, least.min(connectivity.edge(h).0));
            }
            edges.push((ends, if length == 1 { EdgeKind::Input } else { EdgeKind::Chord }, least, patch));
            border.push(ends);
        }
        border.sort_unstable();
        for (triangle, _) in &self.triangles[patch as usize] {
            for side in 0..3 {
                let [a, b] = [triangle[side], triangle[(side + 1) % 3]].map(VertexId);
                // Both sides list the edge; take it once.
                if a < b && border.binary_search(&[a, b]).is_err() {
                    edges.push(([a, b], EdgeKind::Inner, patch, patch));
                }
            }
        }
        edges
    }

    fn resolve_edge(&mut self, &(ends, kind, least, patch): &ResultEdge, again: &mut Vec<u32>) {
        self.attempt_counts[patch as usize] = self.attempt_counts[patch as usize].saturating_add(1);
        if self.attempt_counts[patch as usize] > 2 * MAX_ATTEMPTS {
            return self.keep_patch(patch, again);
        }
        match kind {
            EdgeKind::Input => {}
            EdgeKind::Inner => {
                self.forbidden.push((patch, ends));
                again.push(patch);
            }
            EdgeKind::Chord => {
                let polygon = self.polygon(patch);
                let edge = |h| self.mesh.connectivity.edge(h).0;
                let chord = (0..polygon.corners.len())
                    .find(|&c| polygon.chord_edges(c).map(edge).min() == Some(least));
                let vertex = chord.and_then(|c| polygon.find_farthest(self.mesh, c));
                if let Some((v, _)) = vertex {
                    self.restore_vertex(v, again);
                }
            }
        }
    }

    /// Check the connectivity of the whole result. Edges are valid by now; identical triangles may remain.
    fn check_connectivity(&mut self, again: &mut Vec<u32>) {
        let (vertices, triangles, _, patch) = self.build_output();
        let wrong = match Connectivity::from_triangles(vertices.len(), &triangles) {
            Ok(_) => return,
            Err(KernelError::SameVertices(pairs)) => pairs.into_iter().flatten().collect::<Vec<u32>>(),
            Err(KernelError::PinchedVertices(pinched)) => (0..triangles.len() as u32)
                .filter(|&t| triangles[t as usize].iter().any(|v| pinched.binary_search(v).is_ok()))
                .collect(),
            Err(_) => (0..triangles.len() as u32).collect(),
        };
        let mut concerned: Vec<u32> = wrong.iter().map(|&t| patch[t as usize]).collect();
        concerned.sort_unstable();
        concerned.dedup();
        concerned.retain(|&p| !self.keeps_triangles[p as usize]);
        for number in concerned {
            let relief = self.select_vertices_to_restore(number, &self.polygon(number), &[]);
            match relief {
                Outcome::Restore(vertices) => {
                    self.attempt_counts[number as usize] += 1;
                    vertices.into_iter().for_each(|v| self.restore_vertex(v, again));
                }
                _ => self.keep_patch(number, again),
            }
            again.push(number);
        }
        // Keeping patches changed the result, so check again even if no patch is left to triangulate.
        if self.sort_unique(again.clone()).is_empty() {
            self.check_connectivity(again);
        }
    }
}
