//! Base mesh to encode, as viewed from the border of the coded region.

use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

use super::border::{Border, Left, NONE};
use super::error::SnmError;
use crate::subdivision::contents::Base;

/// Mesh to encode, and the parts of it already coded.
pub(super) struct Given<'a> {
    pub base: &'a Base,
    pub connectivity: Connectivity,
    /// New index of each vertex; [`NONE`] if not coded yet.
    numbers: Vec<u32>,
    /// Border edge at each halfedge whose triangle is not coded yet.
    border: Vec<u32>,
    done: Vec<bool>,
    /// All triangles below this index are coded.
    first_left: usize,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
}

impl<'a> Given<'a> {
    pub(super) fn new(base: &'a Base) -> Result<Self, SnmError> {
        let connectivity = Connectivity::from_triangles(base.positions.len(), &base.triangles);
        let connectivity = connectivity.map_err(SnmError::Mesh)?;
        Ok(Self {
            numbers: vec![NONE; base.positions.len()],
            border: vec![NONE; 3 * base.triangles.len()],
            done: vec![false; base.triangles.len()],
            first_left: 0,
            vertex_source: vec![],
            triangle_source: vec![],
            base,
            connectivity,
        })
    }

    /// Check whether the mesh has a boundary.
    pub(super) fn is_open(&self) -> bool {
        self.connectivity.edges().any(|edge| self.connectivity.is_boundary_edge(edge))
    }

    /// Return a halfedge of a component that is not coded yet.
    pub(super) fn seed(&mut self) -> Option<HalfedgeId> {
        while *self.done.get(self.first_left)? {
            self.first_left += 1;
        }
        Some(HalfedgeId::from_index(3 * self.first_left))
    }

    /// Determine the symbol of a border edge.
    pub(super) fn left(&self, border: &Border, edge: u32) -> Left {
        let gate = border.edge(edge);
        let h = gate.halfedge;
        if h.is_none() {
            return Left::Nothing;
        }
        let (to_tip, from_tip) = (Connectivity::next(h), Connectivity::prev(h));
        let tip = self.connectivity.origin(from_tip);
        let at = |h: HalfedgeId| self.border[h.index()];
        if self.numbers[tip.index()] == NONE {
            Left::New(tip)
        } else if at(to_tip) == gate.next {
            Left::Next
        } else if at(from_tip) == gate.prev {
            Left::Previous
        } else {
            Left::Other(self.gap(border, from_tip))
        }
    }

    /// Find the border edge at the origin of `h` that bounds the uncoded triangle fan around `h`.
    fn gap(&self, border: &Border, h: HalfedgeId) -> u32 {
        let mut clockwise = h;
        loop {
            let edge = self.border[clockwise.index()];
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
            let edge = self.border[arriving.index()];
            if edge != NONE {
                return border.edge(edge).next;
            }
            arriving = Connectivity::prev(self.connectivity.twin(arriving));
        }
    }

    /// Record that the triangle of `h` has been coded.
    pub(super) fn meet_triangle(&mut self, h: HalfedgeId) {
        let TriangleId(triangle) = Connectivity::triangle(h);
        self.done[triangle as usize] = true;
        self.triangle_source.push(triangle);
    }

    /// Record that a vertex has been coded, and give it the next index.
    pub(super) fn meet_vertex(&mut self, VertexId(v): VertexId) {
        self.numbers[v as usize] = self.vertex_source.len() as u32;
        self.vertex_source.push(v);
    }

    /// Record the border edge at a halfedge.
    pub(super) fn meet_edge(&mut self, h: HalfedgeId, edge: u32) {
        self.border[h.index()] = edge;
    }
}
