//! Triangle adjacency: an index-based halfedge structure.
//!
//! Triangle `t` owns halfedges `3t`, `3t+1`, `3t+2`, one from each corner to the next. `next`, `prev` and the
//! triangle are therefore computed from the index. A halfedge stores its origin, its twin in the adjacent
//! triangle (NONE on a boundary) and its edge. A vertex stores one outgoing halfedge. For a boundary vertex
//! it is the one without a twin, from which counter-clockwise rotation visits every triangle of the fan.

use crate::base::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};

#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct Halfedge {
    pub origin: VertexId,
    pub twin: HalfedgeId,
    pub edge: EdgeId,
}

/// Connectivity of an oriented manifold triangle mesh, with or without boundary.
#[derive(Clone, Debug)]
pub struct Connectivity {
    pub(crate) halfedges: Vec<Halfedge>,
    pub(crate) outgoing: Vec<HalfedgeId>,
    pub(crate) edges: Vec<HalfedgeId>,
    pub(crate) triangle_count: usize,
}

/// Changes of the connectivity by a collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CollapseChange {
    pub survivor: VertexId,
    pub removed: VertexId,
    /// For each side with a triangle: the remaining edge, and the edge merged into it.
    pub merged: [Option<(EdgeId, EdgeId)>; 2],
}

impl Connectivity {
    /// Maximum number of triangles: halfedges have 32-bit indices, and one index means NONE.
    pub const MAX_TRIANGLES: usize = (u32::MAX as usize - 1) / 3;

    /// Return the number of remaining triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// Return the length of per-vertex arrays; collapsed vertices keep their index.
    pub fn vertex_slots(&self) -> usize {
        self.outgoing.len()
    }

    /// Return the length of per-edge arrays.
    pub fn edge_slots(&self) -> usize {
        self.edges.len()
    }

    /// Return the length of per-triangle arrays.
    pub fn triangle_slots(&self) -> usize {
        self.halfedges.len() / 3
    }

    /// Iterate over the remaining vertices that have triangles.
    pub fn vertices(&self) -> impl Iterator<Item = VertexId> + '_ {
        let alive = |v: &VertexId| self.outgoing[v.index()].is_some();
        (0..self.outgoing.len()).map(VertexId::from_index).filter(alive)
    }

    /// Iterate over the remaining edges.
    pub fn edges(&self) -> impl Iterator<Item = EdgeId> + '_ {
        let alive = |e: &EdgeId| self.edges[e.index()].is_some();
        (0..self.edges.len()).map(EdgeId::from_index).filter(alive)
    }

    /// Iterate over the remaining triangles.
    pub fn triangles(&self) -> impl Iterator<Item = TriangleId> + '_ {
        let alive = |t: &TriangleId| self.halfedges[3 * t.index()].origin.is_some();
        (0..self.triangle_slots()).map(TriangleId::from_index).filter(alive)
    }

    /// Return the corners of a triangle, counter-clockwise.
    pub fn corners(&self, triangle: TriangleId) -> [VertexId; 3] {
        let first = 3 * triangle.index();
        [0, 1, 2].map(|corner| self.halfedges[first + corner].origin)
    }

    /// Return the next halfedge of the triangle.
    #[inline]
    pub fn next(h: HalfedgeId) -> HalfedgeId {
        HalfedgeId(if h.0 % 3 == 2 { h.0 - 2 } else { h.0 + 1 })
    }

    /// Return the previous halfedge of the triangle.
    #[inline]
    pub fn prev(h: HalfedgeId) -> HalfedgeId {
        HalfedgeId(if h.0.is_multiple_of(3) { h.0 + 2 } else { h.0 - 1 })
    }

    /// Return the triangle of a halfedge.
    #[inline]
    pub fn triangle(h: HalfedgeId) -> TriangleId {
        TriangleId(h.0 / 3)
    }

    /// Return the start vertex of a halfedge.
    #[inline]
    pub fn origin(&self, h: HalfedgeId) -> VertexId {
        self.halfedges[h.index()].origin
    }

    /// Return the end vertex of a halfedge.
    #[inline]
    pub fn target(&self, h: HalfedgeId) -> VertexId {
        self.origin(Self::next(h))
    }

    /// Return the opposite halfedge; NONE on a boundary.
    #[inline]
    pub fn twin(&self, h: HalfedgeId) -> HalfedgeId {
        self.halfedges[h.index()].twin
    }

    /// Return the edge of a halfedge.
    #[inline]
    pub fn edge(&self, h: HalfedgeId) -> EdgeId {
        self.halfedges[h.index()].edge
    }

    /// Return one halfedge of an edge; the only one for a boundary edge.
    #[inline]
    pub fn halfedge(&self, edge: EdgeId) -> HalfedgeId {
        self.edges[edge.index()]
    }

    /// Return true if an edge still exists.
    #[inline]
    pub fn is_edge(&self, edge: EdgeId) -> bool {
        self.halfedge(edge).is_some()
    }

    /// Return the two ends of an edge.
    #[inline]
    pub fn ends(&self, edge: EdgeId) -> [VertexId; 2] {
        let h = self.halfedge(edge);
        [self.origin(h), self.target(h)]
    }

    /// Check whether an edge has only one triangle.
    #[inline]
    pub fn is_boundary_edge(&self, edge: EdgeId) -> bool {
        self.twin(self.halfedge(edge)).is_none()
    }

    /// Check whether a vertex is on a boundary.
    #[inline]
    pub fn is_boundary_vertex(&self, v: VertexId) -> bool {
        self.twin(self.outgoing[v.index()]).is_none()
    }

    /// Iterate over the outgoing halfedges of a vertex, counter-clockwise: one per incident triangle.
    #[inline]
    pub fn fan(&self, v: VertexId) -> Fan<'_> {
        let start = self.outgoing[v.index()];
        Fan { connectivity: self, start, at: start }
    }

    /// Iterate over the edges of a vertex and their other ends, counter-clockwise; at a boundary vertex one
    /// more than triangles.
    #[inline]
    pub fn vertex_edges(&self, v: VertexId) -> VertexEdges<'_> {
        VertexEdges { fan: self.fan(v), last: HalfedgeId::NONE }
    }

    /// Collapse `edge` into its end `survivor`; ask `collapse_legality::can_collapse` first.
    ///
    /// ```text
    ///        a                   a
    ///      / | \                 |        The triangles on both sides vanish, and on each
    ///     /  |  \                |        side the two edges that met at the far corner
    ///   v1 --e-- v2     →        v        (a, b) become one. On a boundary there is only
    ///     \  |  /                |        one side.
    ///      \ | /                 |
    ///        b                   b
    /// ```
    pub fn collapse(&mut self, edge: EdgeId, survivor: VertexId) -> CollapseChange {
        let first = self.halfedge(edge);
        let second = self.twin(first);
        let [v1, v2] = self.ends(edge);
        let removed = if survivor == v1 { v2 } else { v1 };
        let on_boundary = self.is_boundary_vertex(v1) || self.is_boundary_vertex(v2);

        let mut h = self.outgoing[removed.index()];
        let start = h;
        loop {
            self.halfedges[h.index()].origin = survivor;
            h = self.twin(Self::prev(h));
            if h.is_none() || h == start {
                break;
            }
        }

        let (merged_first, spoke) = self.close_triangle(first);
        let merged_second = second.is_some().then(|| self.close_triangle(second).0);
        self.outgoing[survivor.index()] = if on_boundary { self.first_of_fan(spoke) } else { spoke };
        self.outgoing[removed.index()] = HalfedgeId::NONE;
        self.edges[edge.index()] = HalfedgeId::NONE;
        CollapseChange { survivor, removed, merged: [Some(merged_first), merged_second] }
    }

    /// Remove the triangle of `h`, whose edge has shrunk to a point, and merge its other two sides. Returns
    /// the merged edges and a halfedge that starts at the point.
    fn close_triangle(&mut self, h: HalfedgeId) -> ((EdgeId, EdgeId), HalfedgeId) {
        let (from_point, to_point) = (Self::next(h), Self::prev(h));
        let apex = self.origin(to_point);
        let arriving = self.twin(from_point);
        let leaving = self.twin(to_point);
        let (kept, gone) = (self.edge(to_point), self.edge(from_point));

        if arriving.is_some() {
            self.halfedges[arriving.index()].twin = leaving;
            self.halfedges[arriving.index()].edge = kept;
        }
        if leaving.is_some() {
            self.halfedges[leaving.index()].twin = arriving;
        }
        self.edges[kept.index()] = if leaving.is_some() { leaving } else { arriving };
        self.edges[gone.index()] = HalfedgeId::NONE;
        if self.outgoing[apex.index()] == to_point {
            self.outgoing[apex.index()] = arriving;
        }
        for dead in [h, from_point, to_point] {
            self.halfedges[dead.index()].origin = VertexId::NONE;
        }
        self.triangle_count -= 1;
        ((kept, gone), if leaving.is_some() { leaving } else { Self::next(arriving) })
    }

    fn first_of_fan(&self, outgoing: HalfedgeId) -> HalfedgeId {
        let mut h = outgoing;
        loop {
            let twin = self.twin(h);
            if twin.is_none() {
                return h;
            }
            h = Self::next(twin);
            if h == outgoing {
                return h;
            }
        }
    }

    /// Split `edge` at a new vertex. Returns the vertex and the new edges: the far half of `edge`, then
    /// one to the opposite corner of each adjacent triangle.
    ///
    /// ```text
    ///        a                   a
    ///      /   \               / | \
    ///     /     \             /  |  \
    ///   v1 --e-- v2     →   v1-e-m---v2
    ///     \     /             \  |  /
    ///      \   /               \ | /
    ///        b                   b
    /// ```
    pub fn split(&mut self, edge: EdgeId) -> (VertexId, [EdgeId; 3]) {
        let first = self.halfedge(edge);
        let second = self.twin(first);
        let middle = VertexId::from_index(self.outgoing.len());
        let far_half = EdgeId::from_index(self.edges.len());

        let (near, across_first) = self.halve_triangle(first, middle, far_half);
        self.outgoing.push(near);
        self.edges[far_half.index()] = near;
        let mut across_second = EdgeId::NONE;
        if second.is_some() {
            let (back, across) = self.halve_triangle(second, middle, edge);
            across_second = across;
            // Pair the halves: first with back along `edge`, near with second along the far half.
            self.halfedges[first.index()].twin = back;
            self.halfedges[back.index()].twin = first;
            self.halfedges[near.index()].twin = second;
            self.halfedges[second.index()].twin = near;
            self.halfedges[second.index()].edge = far_half;
        }
        (middle, [far_half, across_first, across_second])
    }

    /// Split the triangle of `h` from `middle`, on `h`, to the opposite corner. The triangle keeps the part
    /// at the origin of `h`. Returns the new halfedge of the other part, which gets the edge `beyond`, and
    /// the edge of the cut.
    fn halve_triangle(&mut self, h: HalfedgeId, middle: VertexId, beyond: EdgeId) -> (HalfedgeId, EdgeId) {
        let (side, apex) = (Self::next(h), self.origin(Self::prev(h)));
        let old = self.halfedges[side.index()];
        let new = HalfedgeId::from_index(self.halfedges.len());
        let (new_side, new_cut) = (Self::next(new), Self::prev(new));

        if beyond.index() == self.edges.len() {
            self.edges.push(new);
        }
        let cut = EdgeId::from_index(self.edges.len());
        self.edges.push(side);
        self.halfedges.push(Halfedge { origin: middle, twin: HalfedgeId::NONE, edge: beyond });
        self.halfedges.push(old);
        self.halfedges.push(Halfedge { origin: apex, twin: side, edge: cut });

        self.halfedges[side.index()] = Halfedge { origin: middle, twin: new_cut, edge: cut };
        if old.twin.is_some() {
            self.halfedges[old.twin.index()].twin = new_side;
        }
        if self.edges[old.edge.index()] == side {
            self.edges[old.edge.index()] = new_side;
        }
        if self.outgoing[old.origin.index()] == side {
            self.outgoing[old.origin.index()] = new_side;
        }
        self.triangle_count += 1;
        (new, cut)
    }
}

/// See [`Connectivity::fan`].
pub struct Fan<'a> {
    connectivity: &'a Connectivity,
    start: HalfedgeId,
    at: HalfedgeId,
}

impl Iterator for Fan<'_> {
    type Item = HalfedgeId;

    #[inline]
    fn next(&mut self) -> Option<HalfedgeId> {
        if self.at.is_none() {
            return None;
        }
        let here = self.at;
        let turned = self.connectivity.twin(Connectivity::prev(here));
        self.at = if turned == self.start { HalfedgeId::NONE } else { turned };
        Some(here)
    }
}

/// See [`Connectivity::vertex_edges`].
pub struct VertexEdges<'a> {
    fan: Fan<'a>,
    last: HalfedgeId,
}

impl Iterator for VertexEdges<'_> {
    type Item = (EdgeId, VertexId);

    #[inline]
    fn next(&mut self) -> Option<(EdgeId, VertexId)> {
        let connectivity = self.fan.connectivity;
        if let Some(h) = self.fan.next() {
            let closing = Connectivity::prev(h);
            let at_boundary = connectivity.twin(closing).is_none();
            self.last = if at_boundary { closing } else { HalfedgeId::NONE };
            return Some((connectivity.edge(h), connectivity.target(h)));
        }
        let last = std::mem::replace(&mut self.last, HalfedgeId::NONE);
        last.is_some().then(|| (connectivity.edge(last), connectivity.origin(last)))
    }
}
