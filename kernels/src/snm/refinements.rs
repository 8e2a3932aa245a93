//! Coding of refinements: an offset per edge, and the channels of its vertex.

use crate::subdivision::topology::Topology;

use super::channels::ChannelModels;
use super::coder::{Coder, Exhausted};
use super::offset_kinds::{OffsetKind, OffsetKindModels};
use super::relations::Relations;
use super::scalar_offsets::ScalarModels;
use super::vector_offsets::VectorModels;
use crate::subdivision::snm_contents::{BaseContents, Header, Offset, Refinement};

/// Adaptive models, carried over from level to level.
pub(super) struct RefinementModels {
    /// Number of vertices, and the edges of each triangle, on the coarser level.
    vertices: usize,
    triangle_edges: Option<Vec<[u32; 3]>>,
    has_relaxation: bool,
    exceptions: OffsetKindModels,
    scalars: ScalarModels,
    vectors: VectorModels,
    channels: ChannelModels,
}

impl RefinementModels {
    pub(super) fn new(header: &Header, base: &BaseContents) -> Self {
        let vertices = base.positions.len();
        Self {
            vertices,
            triangle_edges: None,
            has_relaxation: header.relaxations > 0,
            exceptions: OffsetKindModels::new(vertices, header.relaxations > 0),
            scalars: ScalarModels::new(header.step_ratio, vertices),
            vectors: VectorModels::new(),
            channels: ChannelModels::new(header.channels.into(), &base.channels),
        }
    }

    /// Check whether `topology` is the next level and the other arguments of [`RefinementModels::code_level`] match it.
    pub(super) fn is_next_level(
        &self,
        topology: &Topology,
        expected: &[i32],
        given: Option<&Refinement>,
    ) -> bool {
        let edges = topology.edges.len();
        let is_finer = |coarse: &Vec<_>| topology.triangles.len() == 4 * coarse.len();
        let is_whole = |given: &Refinement| {
            let is_scalar = |edge: usize| !matches!(given.offsets[edge], Offset::Vector(_));
            given.channels.len() == if self.channels.is_empty() { 0 } else { edges }
                && given.offsets.len() == edges
                && !(0..edges).any(|edge| topology.is_boundary_edge(edge) && is_scalar(edge))
                && (self.has_relaxation || !given.offsets.iter().any(|o| matches!(o, Offset::Unrelaxed(_))))
        };
        topology.vertices == self.vertices
            && self.triangle_edges.as_ref().is_none_or(is_finer)
            && (expected.is_empty() || expected.len() == edges)
            && given.is_none_or(is_whole)
    }

    /// Code a level on `topology`. A decoder has no `encoder_input` refinement.
    pub(super) fn code_level<C: Coder>(
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
                Offset::Scalar(scalar) => (OffsetKind::Scalar, scalar, [0; 3]),
                Offset::Unrelaxed(scalar) => (OffsetKind::Unrelaxed, scalar, [0; 3]),
                Offset::Vector(vector) => (OffsetKind::Vector, 0, vector),
            };
            let kind = if topology.is_boundary_edge(edge) {
                OffsetKind::Vector
            } else {
                let rough = self.scalars.estimate_roughness(&relations, edge);
                self.exceptions.code(coder, &relations, edge, rough, kind)?
            };
            offsets[edge] = if kind == OffsetKind::Vector {
                Offset::Vector(self.vectors.code_vector(coder, &relations, edge, &offsets, vector)?)
            } else {
                let expected = expected.get(edge).copied().unwrap_or(0);
                let scalar = self.scalars.code_scalar(coder, &relations, edge, expected, scalar)?;
                if kind == OffsetKind::Scalar { Offset::Scalar(scalar) } else { Offset::Unrelaxed(scalar) }
            };
        }
        let channels = self.channels.code_level(coder, &relations, given.map(|given| &given.channels[..]))?;
        self.exceptions.end_level();
        self.scalars.end_level(&relations);
        self.vectors.end_level(&offsets);
        self.vertices += topology.edges.len();
        self.triangle_edges = Some(topology.triangle_edges.clone());
        Ok(Refinement { offsets, channels })
    }
}
