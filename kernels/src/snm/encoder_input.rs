//! Base mesh to encode, as viewed from the border of the coded region.

use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

use super::border::{Border, GateSymbol, NONE};
use super::error::SnmError;
use crate::subdivision::snm_contents::BaseContents;

/// Mesh to encode, and the parts of it already coded.
pub(super) struct EncoderInput<'a> {
    pub base: &'a BaseContents,
    pub connectivity: Connectivity,
    /// New index of each vertex; [`NONE`] if not coded yet.
    new_index: Vec<u32>,
    /// Border edge at each halfedge whose triangle is not coded yet.
    border_edge: Vec<u32>,
    is_coded: Vec<bool>,
    /// All triangles below this index are coded.
    first_uncoded: usize,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
}

impl<'a> EncoderInput<'a> {
    pub(super) fn new(base: &'a BaseContents) -> Result<Self, SnmError> {
        let connectivity = Connectivity::from_triangles(base.positions.len(), &base.triangles);
        let connectivity = connectivity.map_err(SnmError::Mesh)?;
        Ok(Self {
            new_index: vec![NONE; base.positions.len()],
            border_edge: vec![NONE; 3 * base.triangles.len()],
            is_coded: vec![false; base.triangles.len()],
            first_uncoded: 0,
            vertex_source: vec![],
            triangle_source: vec![],
            base,
            connectivity,
        })
    }

    /// Check whether the mesh has a boundary.
    pub(super) fn has_boundary(&self) -> bool {
        self.connectivity.edges().any(|edge| self.connectivity.is_boundary_edge(edge))
    }

    /// Return a halfedge of a component that is not coded yet.
    pub(super) fn next_seed(&mut self) -> Option<HalfedgeId> {
        while *self.is_coded.get(self.first_uncoded)? {
            self.first_uncoded += 1;
        }
        Some(HalfedgeId::from_index(3 * self.first_uncoded))
    }

    /// Determine the symbol of a border edge.
    pub(super) fn find_symbol(&self, border: &Border, edge: u32) -> GateSymbol {
        let gate = border.edge(edge);
        let h = gate.halfedge;
        if h.is_none() {
            return GateSymbol::MeshBoundary;
        }
        let (to_tip, from_tip) = (Connectivity::next(h), Connectivity::prev(h));
        let tip = self.connectivity.origin(from_tip);
        let at = |h: HalfedgeId| self.border_edge[h.index()];
        if self.new_index[tip.index()] == NONE {
            GateSymbol::NewVertex(tip)
        } else if at(to_tip) == gate.next {
            GateSymbol::Next
        } else if at(from_tip) == gate.prev {
            GateSymbol::Previous
        } else {
            GateSymbol::OtherVertex(self.find_fan_end(border, from_tip))
        }
    }

    /// Find the border edge at the origin of `h` that bounds the uncoded triangle fan around `h`.
    fn find_fan_end(&self, border: &Border, h: HalfedgeId) -> u32 {
        let mut clockwise = h;
        loop {
            let edge = self.border_edge[clockwise.index()];
            if edge != NONE {
                return edge;
            }
            let twin = self.connectivity.twin(clockwise);
            if twin.is_none() {
                break;
            }
            clockwise = Connectivity::next(twin);
        }
        // A mesh boundary interrupts the fan, so the border edge is at its other end.
        let mut arriving = Connectivity::prev(h);
        loop {
            let edge = self.border_edge[arriving.index()];
            if edge != NONE {
                return border.edge(edge).next;
            }
            arriving = Connectivity::prev(self.connectivity.twin(arriving));
        }
    }

    /// Record that the triangle of `h` has been coded.
    pub(super) fn record_triangle(&mut self, h: HalfedgeId) {
        let TriangleId(triangle) = Connectivity::triangle(h);
        self.is_coded[triangle as usize] = true;
        self.triangle_source.push(triangle);
    }

    /// Record that a vertex has been coded, and give it the next index.
    pub(super) fn record_vertex(&mut self, VertexId(v): VertexId) {
        self.new_index[v as usize] = self.vertex_source.len() as u32;
        self.vertex_source.push(v);
    }

    /// Record the border edge at a halfedge.
    pub(super) fn record_edge(&mut self, h: HalfedgeId, edge: u32) {
        self.border_edge[h.index()] = edge;
    }
}
