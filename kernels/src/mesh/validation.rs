//! Checks of all invariants of the connectivity. Slow; intended for tests.

use crate::base::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Violated invariant, with its element.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ConnectivityDefect {
    /// The twin of a halfedge does not run back along the same edge.
    Twin(HalfedgeId),
    /// The halfedge of an edge does not belong to the edge.
    Edge(EdgeId),
    /// The halfedge of a vertex does not start there, or is not the first of the fan of a boundary vertex.
    Outgoing(VertexId),
    /// The fan of a vertex misses some of its triangles.
    Pinched(VertexId),
    /// A triangle with a removed or repeated vertex.
    Corners(TriangleId),
    /// Two edges with the same ends.
    Parallel(EdgeId, EdgeId),
    /// The triangle count is wrong.
    Count,
}

/// Topological invariants of collapses and splits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Topology {
    pub euler: i64,
    pub boundary_loops: usize,
    pub components: usize,
}

impl Connectivity {
    /// Check all invariants.
    ///
    /// # Errors
    /// The first defect found.
    pub fn validate(&self) -> Result<(), ConnectivityDefect> {
        let mut degree = vec![0usize; self.vertex_slots()];
        for t in self.triangles() {
            let corners = self.corners(t);
            let alive = |v: VertexId| v.index() < degree.len() && self.outgoing[v.index()].is_some();
            let distinct = corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0];
            if !distinct || !corners.into_iter().all(alive) {
                return Err(ConnectivityDefect::Corners(t));
            }
            for (corner, v) in corners.into_iter().enumerate() {
                degree[v.index()] += 1;
                self.validate_halfedge(HalfedgeId(3 * t.0 + corner as u32))?;
            }
        }
        for e in self.edges() {
            let h = self.halfedge(e);
            if self.origin(h).is_none() || self.edge(h) != e {
                return Err(ConnectivityDefect::Edge(e));
            }
        }
        for v in self.vertices() {
            let h = self.outgoing[v.index()];
            let on_boundary = self.vertex_edges(v).any(|(e, _)| self.is_boundary_edge(e));
            if self.origin(h) != v || on_boundary != self.twin(h).is_none() {
                return Err(ConnectivityDefect::Outgoing(v));
            }
            if self.fan(v).count() != degree[v.index()] {
                return Err(ConnectivityDefect::Pinched(v));
            }
        }
        self.find_parallel_edges()?;
        if self.triangles().count() == self.triangle_count() {
            Ok(())
        } else {
            Err(ConnectivityDefect::Count)
        }
    }

    fn validate_halfedge(&self, h: HalfedgeId) -> Result<(), ConnectivityDefect> {
        let twin = self.twin(h);
        let runs_back = twin.is_none()
            || (self.twin(twin) == h
                && self.origin(twin) == self.target(h)
                && self.target(twin) == self.origin(h)
                && self.edge(twin) == self.edge(h));
        if !runs_back {
            return Err(ConnectivityDefect::Twin(h));
        }
        let own = self.halfedge(self.edge(h));
        if own != h && (twin.is_none() || own != twin) {
            Err(ConnectivityDefect::Edge(self.edge(h)))
        } else {
            Ok(())
        }
    }

    fn find_parallel_edges(&self) -> Result<(), ConnectivityDefect> {
        let mut edges: Vec<([VertexId; 2], EdgeId)> = self
            .edges()
            .map(|e| {
                let [a, b] = self.ends(e);
                ([a.min(b), a.max(b)], e)
            })
            .collect();
        edges.sort_unstable();
        match edges.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            Some(pair) => Err(ConnectivityDefect::Parallel(pair[0].1, pair[1].1)),
            None => Ok(()),
        }
    }

    /// Compute the Euler characteristic, the boundary loops and the connected components.
    pub fn topology(&self) -> Topology {
        let vertices = self.vertices().count() as i64;
        let edges = self.edges().count() as i64;
        let euler = vertices - edges + self.triangle_count() as i64;
        Topology { euler, boundary_loops: self.boundary_loops(), components: self.components() }
    }

    fn boundary_loops(&self) -> usize {
        let mut seen = vec![false; self.vertex_slots()];
        let mut loops = 0;
        for start in self.vertices().filter(|&v| self.is_boundary_vertex(v)) {
            let mut v = start;
            loops += usize::from(!seen[v.index()]);
            while !std::mem::replace(&mut seen[v.index()], true) {
                v = self.target(self.outgoing[v.index()]);
            }
        }
        loops
    }

    fn components(&self) -> usize {
        let mut seen = vec![false; self.vertex_slots()];
        let mut components = 0;
        for start in self.vertices() {
            components += usize::from(!seen[start.index()]);
            let mut reached = vec![start];
            while let Some(v) = reached.pop() {
                if !std::mem::replace(&mut seen[v.index()], true) {
                    reached.extend(self.vertex_edges(v).map(|(_, w)| w));
                }
            }
        }
        components
    }
}
