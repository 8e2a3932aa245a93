//! The border of a growing region of triangles: loops of directed edges with the region on their right.
//!
//! ```text
//!         x             A triangle put on the edge u → v has its tip either at a new vertex, or at the
//!        / \            far end of the next or of the previous edge, or elsewhere on the border. In the
//!       /   \           last case the edges u → x and x → v are linked where the border passes x: one
//!   … → u → v → …       loop becomes two, or two become one.
//! ```

use crate::base::ids::{HalfedgeId, VertexId};

pub(super) const NONE: u32 = u32::MAX;

/// What is on the left of an edge of the border.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Left {
    /// The boundary of the mesh.
    Nothing,
    /// A triangle with its tip at the far end of the next edge, or of the previous.
    Next,
    Previous,
    /// One with a new tip, which has this number in the mesh to encode.
    New(VertexId),
    /// One with its tip where this edge of the border begins.
    Other(u32),
}

/// A directed edge of the border; what is on its left is still open.
#[derive(Clone, Copy)]
pub(super) struct Edge {
    pub origin: u32,
    /// The corner across, of the triangle on its right.
    pub across: u32,
    pub prev: u32,
    pub next: u32,
    /// Nothing will ever be on its left: it is on the boundary of the mesh.
    pub closed: bool,
    /// Where it stands in the list of all on the border, [`NONE`] once it has left.
    place: u32,
    /// The halfedge on its left, in the mesh to encode.
    pub halfedge: HalfedgeId,
}

#[derive(Default)]
pub(super) struct Border {
    edges: Vec<Edge>,
    /// The numbers of those that are on the border, in no order.
    present: Vec<u32>,
}

impl Border {
    pub(super) fn edge(&self, edge: u32) -> &Edge {
        &self.edges[edge as usize]
    }

    pub(super) fn target(&self, edge: u32) -> u32 {
        self.edge(self.edge(edge).next).origin
    }

    pub(super) fn is_present(&self, edge: u32) -> bool {
        self.edge(edge).place != NONE
    }

    /// Whether a triangle may be put on an edge.
    pub(super) fn is_open(&self, edge: u32) -> bool {
        self.is_present(edge) && !self.edge(edge).closed
    }

    pub(super) fn present(&self) -> &[u32] {
        &self.present
    }

    pub(super) fn close(&mut self, edge: u32) {
        self.edges[edge as usize].closed = true;
    }

    pub(super) fn add(&mut self, origin: u32, across: u32, halfedge: HalfedgeId) -> u32 {
        let number = self.edges.len() as u32;
        let place = self.present.len() as u32;
        self.present.push(number);
        let (prev, next) = (NONE, NONE);
        self.edges.push(Edge { origin, across, prev, next, closed: false, place, halfedge });
        number
    }

    pub(super) fn link(&mut self, edge: u32, next: u32) {
        self.edges[edge as usize].next = next;
        self.edges[next as usize].prev = edge;
    }

    pub(super) fn remove(&mut self, edge: u32) {
        let place = std::mem::replace(&mut self.edges[edge as usize].place, NONE);
        self.present.swap_remove(place as usize);
        if let Some(&moved) = self.present.get(place as usize) {
            self.edges[moved as usize].place = place;
        }
    }
}
