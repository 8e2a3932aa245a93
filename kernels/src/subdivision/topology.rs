//! Connectivity of linear 1–4 subdivision.
//!
//! ```text
//!          c              Edge i of a triangle goes from corner i to corner i + 1. Its midpoint
//!         / \             becomes vertex n + (index of the edge), with n the number of coarse
//!        / 2 \            vertices. Triangle t has the children 4t to 4t + 3: one at each corner,
//!      ca --- bc          which keeps that corner's position in the triangle, and the middle one.
//!      / \ 3 / \          Encoder and decoder number all elements by this rule alone.
//!     / 0 \ / 1 \
//!    a --- ab --- b
//! ```

use crate::base::errors::KernelError;
use crate::base::ids::{HalfedgeId, TriangleId};
use crate::mesh::connectivity::Connectivity;

/// No triangle: the outer side of a boundary edge.
pub const NONE: u32 = u32::MAX;

/// Triangles with edges numbered by first appearance, triangle by triangle and corner by corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Topology {
    pub vertices: usize,
    pub triangles: Vec<[u32; 3]>,
    /// Ends of each edge, in the direction of its first triangle.
    pub edges: Vec<[u32; 2]>,
    /// Edges of each triangle: corner 0 to 1, 1 to 2, 2 to 0.
    pub triangle_edges: Vec<[u32; 3]>,
    /// First and second triangle of each edge; the second is [`NONE`] on a boundary.
    pub edge_triangles: Vec<[u32; 2]>,
}

impl Topology {
    /// Build the topology of a triangle list.
    ///
    /// # Errors
    /// As [`Connectivity::from_triangles`].
    pub fn new(vertices: usize, triangles: Vec<[u32; 3]>) -> Result<Self, KernelError> {
        let connectivity = Connectivity::from_triangles(vertices, &triangles)?;
        let mut topology = Self {
            vertices,
            triangle_edges: vec![[NONE; 3]; triangles.len()],
            edges: Vec::with_capacity(connectivity.edge_slots()),
            edge_triangles: Vec::with_capacity(connectivity.edge_slots()),
            triangles,
        };
        for t in 0..topology.triangles.len() {
            for corner in 0..3 {
                if topology.triangle_edges[t][corner] != NONE {
                    continue;
                }
                let edge = topology.edges.len() as u32;
                let h = HalfedgeId::from_index(3 * t + corner);
                topology.triangle_edges[t][corner] = edge;
                topology.edges.push([corner, (corner + 1) % 3].map(|i| topology.triangles[t][i]));
                let twin = connectivity.twin(h);
                topology.edge_triangles.push([t as u32, NONE]);
                if twin.is_some() {
                    let TriangleId(other) = Connectivity::triangle(twin);
                    topology.triangle_edges[other as usize][twin.index() % 3] = edge;
                    topology.edge_triangles[edge as usize][1] = other;
                }
            }
        }
        Ok(topology)
    }

    /// Check whether an edge has only one triangle.
    pub fn is_boundary_edge(&self, edge: usize) -> bool {
        self.edge_triangles[edge][1] == NONE
    }

    /// Return the corners opposite an edge; [`NONE`] beyond a boundary.
    pub fn opposite_corners(&self, edge: usize) -> [u32; 2] {
        self.edge_triangles[edge].map(|t| {
            if t == NONE {
                return NONE;
            }
            let corner = self.triangle_edges[t as usize].iter().position(|&e| e as usize == edge);
            // Every triangle adjacent to the edge contains it.
            corner.map_or(NONE, |i| self.triangles[t as usize][(i + 2) % 3])
        })
    }

    /// Return the four children of a triangle.
    pub fn children(&self, t: usize) -> [[u32; 3]; 4] {
        let [a, b, c] = self.triangles[t];
        let [ab, bc, ca] = self.triangle_edges[t].map(|e| self.vertices as u32 + e);
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    }

    /// Build the next finer level.
    pub fn subdivide(&self) -> Self {
        let triangles = (0..self.triangles.len()).flat_map(|t| self.children(t)).collect();
        let vertices = self.vertices + self.edges.len();
        Self::number_edges(vertices, triangles, self)
    }

    /// Number the edges of the children of `coarse`, without searching for twins.
    fn number_edges(vertices: usize, triangles: Vec<[u32; 3]>, coarse: &Self) -> Self {
        let mut fine = Self {
            vertices,
            edges: Vec::with_capacity(2 * coarse.edges.len() + 3 * coarse.triangles.len()),
            triangle_edges: vec![[NONE; 3]; triangles.len()],
            edge_triangles: Vec::with_capacity(2 * coarse.edges.len() + 3 * coarse.triangles.len()),
            triangles,
        };
        for t in 0..fine.triangles.len() {
            for corner in 0..3 {
                if fine.triangle_edges[t][corner] != NONE {
                    continue;
                }
                let edge = fine.edges.len() as u32;
                let [from, to] = [corner, (corner + 1) % 3].map(|i| fine.triangles[t][i]);
                fine.triangle_edges[t][corner] = edge;
                fine.edges.push([from, to]);
                let other = coarse.child_across_edge(t, corner);
                fine.edge_triangles.push([t as u32, other]);
                if other != NONE {
                    let back = fine.triangles[other as usize].iter().position(|&v| v == to);
                    if let Some(back) = back {
                        fine.triangle_edges[other as usize][back] = edge;
                    }
                }
            }
        }
        fine
    }

    /// Find the child across edge `corner` of child `child`.
    fn child_across_edge(&self, child: usize, corner: usize) -> u32 {
        let (parent, place) = (child / 4, child % 4);
        if place == 3 {
            // In the middle child, ab–bc faces the child at b, bc–ca the one at c, ca–ab the one at a.
            return (4 * parent + (corner + 1) % 3) as u32;
        }
        if corner == (place + 1) % 3 {
            return (4 * parent + 3) as u32;
        }
        // Half of a parent edge, next to corner `place`.
        let edge = self.triangle_edges[parent][corner] as usize;
        let [first, second] = self.edge_triangles[edge];
        let other = if first as usize == parent { second } else { first };
        if other == NONE {
            return NONE;
        }
        let end = self.triangles[parent][place];
        let at = self.triangles[other as usize].iter().position(|&v| v == end);
        at.map_or(NONE, |i| 4 * other + i as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbering_without_search_is_that_by_search() {
        // A strip of two triangles, with and without a tetrahedron.
        let strip = vec![[0, 1, 2], [2, 1, 3]];
        let closed: Vec<[u32; 3]> = vec![[4, 5, 6], [4, 6, 7], [4, 7, 5], [5, 7, 6]];
        for triangles in [strip.clone(), [strip, closed].concat()] {
            let mut topology = Topology::new(8, triangles).unwrap();
            for _ in 0..3 {
                let fine = topology.subdivide();
                let searched = Topology::new(fine.vertices, fine.triangles.clone()).unwrap();
                assert_eq!(fine, searched);
                topology = fine;
            }
        }
    }
}
