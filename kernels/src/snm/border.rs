//! Border of a growing region of triangles: loops of directed edges with the region on their right.
//!
//! ```text
//!         x             A triangle attached to the edge u → v has its tip at a new vertex, at the far
//!        / \            end of the next or previous edge, or elsewhere on the border. In the last
//!       /   \           case, edges u → x and x → v are linked at x: one loop becomes two, or two
//!  … → u → v → …       become one.
//! ```

use crate::base::ids::{HalfedgeId, VertexId};

pub(super) const NONE: u32 = u32::MAX;

/// Symbol of a gate: the content on the left of a border edge.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum GateSymbol {
    /// Mesh boundary.
    MeshBoundary,
    /// Triangle with its tip at the far end of the next edge, or of the previous edge.
    Next,
    Previous,
    /// Triangle with a new tip; the value is its vertex in the mesh to encode.
    NewVertex(VertexId),
    /// Triangle with its tip at the origin of this border edge.
    OtherVertex(u32),
}

/// Directed edge of the border, with its left side not coded yet.
#[derive(Clone, Copy)]
pub(super) struct BorderEdge {
    pub origin: u32,
    /// Opposite corner of the triangle on its right.
    pub opposite: u32,
    pub prev: u32,
    pub next: u32,
    /// True on the mesh boundary, where no triangle will follow.
    pub is_boundary: bool,
    /// Index in [`Border::present`]; [`NONE`] after the edge has left the border.
    list_index: u32,
    /// Halfedge on its left, in the mesh to encode.
    pub halfedge: HalfedgeId,
}

/// Border edges, with linked loops.
#[derive(Default)]
pub(super) struct Border {
    edges: Vec<BorderEdge>,
    /// Indices of the edges on the border, unordered.
    present: Vec<u32>,
}

impl Border {
    pub(super) fn edge(&self, edge: u32) -> &BorderEdge {
        &self.edges[edge as usize]
    }

    /// Return the vertex at the far end of an edge.
    pub(super) fn target(&self, edge: u32) -> u32 {
        self.edge(self.edge(edge).next).origin
    }

    /// Check whether an edge is still on the border.
    pub(super) fn is_present(&self, edge: u32) -> bool {
        self.edge(edge).list_index != NONE
    }

    /// Check whether a triangle may be attached to an edge.
    pub(super) fn is_open(&self, edge: u32) -> bool {
        self.is_present(edge) && !self.edge(edge).is_boundary
    }

    /// Return the edges on the border, unordered.
    pub(super) fn present(&self) -> &[u32] {
        &self.present
    }

    /// Mark an edge as mesh boundary.
    pub(super) fn mark_boundary(&mut self, edge: u32) {
        self.edges[edge as usize].is_boundary = true;
    }

    /// Add an unlinked edge and return its index.
    pub(super) fn add(&mut self, origin: u32, across: u32, halfedge: HalfedgeId) -> u32 {
        let number = self.edges.len() as u32;
        let place = self.present.len() as u32;
        self.present.push(number);
        let (prev, next) = (NONE, NONE);
        self.edges.push(BorderEdge {
            origin,
            opposite: across,
            prev,
            next,
            is_boundary: false,
            list_index: place,
            halfedge,
        });
        number
    }

    /// Make `next` the successor of `edge` in its loop.
    pub(super) fn link(&mut self, edge: u32, next: u32) {
        self.edges[edge as usize].next = next;
        self.edges[next as usize].prev = edge;
    }

    /// Remove an edge from the border.
    pub(super) fn remove(&mut self, edge: u32) {
        let place = std::mem::replace(&mut self.edges[edge as usize].list_index, NONE);
        self.present.swap_remove(place as usize);
        if let Some(&moved) = self.present.get(place as usize) {
            self.edges[moved as usize].list_index = place;
        }
    }
}
