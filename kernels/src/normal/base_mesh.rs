//! Base mesh with the parts of the input that its triangles and boundary edges represent.

use super::associated_sets::AssociatedSets;
use super::base_parametrization::BasePoint;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::collapse::engine::Merge;
use crate::subdivision::topology::NONE;

/// Base mesh and its correspondence to the input.
#[derive(Clone, Debug)]
pub struct Base {
    /// Input vertex of each base vertex.
    pub vertex_source: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Associated set of each base triangle: original triangles, in the caller's numbering.
    pub sets: AssociatedSets,
    pub chains: Vec<Chain>,
    /// Position of each input vertex on the base; [`BasePoint::UNDEFINED`] for unused vertices.
    pub base_points: Vec<BasePoint>,
    /// Collapses that produced the base, in order.
    pub collapses: Vec<Collapse>,
}

/// One half-edge collapse, in vertex ids of the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Collapse {
    pub removed: VertexId,
    pub survivor: VertexId,
}

impl From<&Merge> for Collapse {
    fn from(merge: &Merge) -> Self {
        Self { removed: merge.removed, survivor: merge.survivor }
    }
}

/// Chain of original boundary edges that one boundary edge of the base represents.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Base vertices at both ends.
    pub ends: [u32; 2],
    /// Boundary halfedges of the input, from the first end to the second.
    pub halfedges: Vec<HalfedgeId>,
}

impl Base {
    /// Renumber vertices and triangles. `vertices` and `triangles` give the old index of each new one.
    /// `corners` gives the new triangles, which may start from another corner.
    pub fn renumber(self, vertices: &[u32], triangles: &[u32], corners: &[[u32; 3]]) -> Self {
        let mut new_vertex = vec![NONE; self.vertex_source.len()];
        vertices.iter().enumerate().for_each(|(new, &old)| new_vertex[old as usize] = new as u32);
        let mut new_triangle = vec![NONE; self.triangles.len()];
        triangles.iter().enumerate().for_each(|(new, &old)| new_triangle[old as usize] = new as u32);
        let moved = |parameter: &BasePoint| {
            if parameter.triangle == NONE {
                return BasePoint::UNDEFINED;
            }
            let was = self.triangles[parameter.triangle as usize].map(|v| new_vertex[v as usize]);
            let triangle = new_triangle[parameter.triangle as usize];
            let first = corners[triangle as usize].map(|v| was.iter().position(|&w| w == v).unwrap_or(0));
            BasePoint { triangle, barycentric: first.map(|i| parameter.barycentric[i]) }
        };
        Self {
            base_points: self.base_points.iter().map(moved).collect(),
            vertex_source: vertices.iter().map(|&v| self.vertex_source[v as usize]).collect(),
            triangles: corners.to_vec(),
            sets: self.sets.permute(triangles),
            collapses: self.collapses,
            chains: self
                .chains
                .into_iter()
                .map(|chain| Chain { ends: chain.ends.map(|v| new_vertex[v as usize]), ..chain })
                .collect(),
        }
    }
}
