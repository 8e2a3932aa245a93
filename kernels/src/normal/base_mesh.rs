//! The base mesh, and what every triangle and boundary edge of it stands for.

use super::associated::Sets;
use super::parameters::Parameter;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::collapse::engine::Merge;
use crate::subdivision::topology::NONE;

/// A base mesh and what it stands for.
#[derive(Clone, Debug)]
pub struct Base {
    /// The input's vertex that each base vertex is.
    pub vertex_source: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Of each triangle: original triangles, in the numbering asked for.
    pub sets: Sets,
    pub chains: Vec<Chain>,
    /// Where each vertex of the input lies. No triangle for those that none uses.
    pub parameters: Vec<Parameter>,
    /// The collapses that made it.
    pub collapses: Vec<Collapse>,
}

/// A vertex of the input that is gone, and the one that took its place.
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

/// What a boundary edge of the base stands for.
#[derive(Clone, Debug)]
pub struct Chain {
    /// The base vertices it joins.
    pub ends: [u32; 2],
    /// Boundary halfedges of the input from the first to the second.
    pub halfedges: Vec<HalfedgeId>,
}

impl Base {
    /// The same with other numbers: `vertices` and `triangles` give the old number of each new one, `corners` the new
    /// triangles, which may start from another corner.
    pub fn reordered(self, vertices: &[u32], triangles: &[u32], corners: &[[u32; 3]]) -> Self {
        let mut new_vertex = vec![NONE; self.vertex_source.len()];
        vertices.iter().enumerate().for_each(|(new, &old)| new_vertex[old as usize] = new as u32);
        let mut new_triangle = vec![NONE; self.triangles.len()];
        triangles.iter().enumerate().for_each(|(new, &old)| new_triangle[old as usize] = new as u32);
        let moved = |parameter: &Parameter| {
            if parameter.triangle == NONE {
                return Parameter::NOWHERE;
            }
            let was = self.triangles[parameter.triangle as usize].map(|v| new_vertex[v as usize]);
            let triangle = new_triangle[parameter.triangle as usize];
            let first = corners[triangle as usize].map(|v| was.iter().position(|&w| w == v).unwrap_or(0));
            Parameter { triangle, barycentric: first.map(|i| parameter.barycentric[i]) }
        };
        Self {
            parameters: self.parameters.iter().map(moved).collect(),
            vertex_source: vertices.iter().map(|&v| self.vertex_source[v as usize]).collect(),
            triangles: corners.to_vec(),
            sets: self.sets.reordered(triangles),
            collapses: self.collapses,
            chains: self
                .chains
                .into_iter()
                .map(|chain| Chain { ends: chain.ends.map(|v| new_vertex[v as usize]), ..chain })
                .collect(),
        }
    }
}
