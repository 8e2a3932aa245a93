//! Coding of refinements: an offset per edge, and the channels of its vertex.

use crate::subdivision::topology::Topology;

use super::channels::Channels;
use super::coder::{Coder, Exhausted};
use super::exceptions::{Exceptions, Kind};
use super::relations::Relations;
use super::scalars::Scalars;
use super::vectors::Vectors;
use crate::subdivision::contents::{Base, Header, Offset, Refinement};

/// Adaptive models, carried over from level to level.
pub(super) struct Levels {
    /// Number of vertices, and the edges of each triangle, on the coarser level.
    vertices: usize,
    triangle_edges: Option<Vec<[u32; 3]>>,
    relaxed: bool,
    exceptions: Exceptions,
    scalars: Scalars,
    vectors: Vectors,
    channels: Channels,
}

impl Levels {
    pub(super) fn new(header: &Header, base: &Base) -> Self {
        let vertices = base.positions.len();
        Self {
            vertices,
            triangle_edges: None,
            relaxed: header.relaxations > 0,
            exceptions: Exceptions::new(vertices, header.relaxations > 0),
            scalars: Scalars::new(header.step_ratio, vertices),
            vectors: Vectors::new(),
            channels: Channels::new(header.channels.into(), &base.channels),
        }
    }

    /// Check whether `topology` is the next level and the other arguments of [`Levels::code`] match it.
    pub(super) fn fits(&self, topology: &Topology, expected: &[i32], given: Option<&Refinement>) -> bool {
        let edges = topology.edges.len();
        let is_finer = |coarse: &Vec<_>| topology.triangles.len() == 4 * coarse.len();
        let is_whole = |given: &Refinement| {
            let is_scalar = |edge: usize| !matches!(given.offsets[edge], Offset::Vector(_));
            given.channels.len() == if self.channels.is_empty() { 0 } else { edges }
                && given.offsets.len() == edges
                && !(0..edges).any(|edge| topology.is_boundary_edge(edge) && is_scalar(edge))
                && (self.relaxed || !given.offsets.iter().any(|o| matches!(o, Offset::Unrelaxed(_))))
        };
        topology.vertices == self.vertices
            && self.triangle_edges.as_ref().is_none_or(is_finer)
            && (expected.is_empty() || expected.len() == edges)
            && given.is_none_or(is_whole)
    }

    /// Code a level on `topology`. A decoder has no `given` refinement.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        topology: &Topology,
        expected: &[i32],
        given: Option<&Refinement>,
    ) -> Result<Refinement, Exhausted> {
        let relations = Relations::new(topology, self.triangle_edges.as_deref());
        let mut offsets = vec![Offset::Scalar(0); topology.edges.len()];
        self.exceptions.begin_level(&relations);
        self.scalars.begin_level(&relations);
        for &edge in &relations.order {
            let edge = edge as usize;
            let given = given.map_or(Offset::Scalar(0), |given| given.offsets[edge]);
            // The decoder passes placeholders, which its coder ignores.
            let (kind, scalar, vector) = match given {
                Offset::Scalar(scalar) => (Kind::Scalar, scalar, [0; 3]),
                Offset::Unrelaxed(scalar) => (Kind::Unrelaxed, scalar, [0; 3]),
                Offset::Vector(vector) => (Kind::Vector, 0, vector),
            };
            let kind = if topology.is_boundary_edge(edge) {
                Kind::Vector
            } else {
                let rough = self.scalars.roughness(&relations, edge);
                self.exceptions.code(coder, &relations, edge, rough, kind)?
            };
            offsets[edge] = if kind == Kind::Vector {
                Offset::Vector(self.vectors.code(coder, &relations, edge, &offsets, vector)?)
            } else {
                let expected = expected.get(edge).copied().unwrap_or(0);
                let scalar = self.scalars.code(coder, &relations, edge, expected, scalar)?;
                if kind == Kind::Scalar { Offset::Scalar(scalar) } else { Offset::Unrelaxed(scalar) }
            };
        }
        let channels = self.channels.code(coder, &relations, given.map(|given| &given.channels[..]))?;
        self.exceptions.end_level();
        self.scalars.end_level(&relations);
        self.vectors.end_level(&offsets);
        self.vertices += topology.edges.len();
        self.triangle_edges = Some(topology.triangle_edges.clone());
        Ok(Refinement { offsets, channels })
    }
}
