//! Coding of offset kinds. Exceptions are offsets other than a scalar; they cluster, and recur from level to
//! level.

use super::coder::{Coder, Exhausted};
use super::decisions::{Decisions, Rates};
use super::relations::Relations;

const RATES: Rates = Rates {
    regression: [0.1, 5e-5],
    mixer: [0.02, 1e-6],
    memory: 1000,
    prior_weight: 3,
    min_probability: 16,
};

/// Initial weights, fitted to normal meshes of horse, cow, bunny, igea, rocker-arm and fandisk.
const INITIAL_WEIGHTS: [f32; 7] = [-5.2, 1.5, 1.8, 0.55, 1.1, 0.1, -0.3];

/// Adaptive models of offset kinds.
pub(super) struct OffsetKindModels {
    models: Decisions<7, 3>,
    /// True if points are relaxed. Exceptions can then be scalars from the unrelaxed point.
    has_relaxation: bool,
    unrelaxed: Decisions<1, 1>,
    /// Edges of the coarser level with exceptions, and vertices that were added by an exception.
    coarser_edges: Vec<bool>,
    vertices: Vec<bool>,
    edges: Vec<bool>,
    /// Number of exceptions among the coded edges of each vertex.
    exception_counts: Vec<u8>,
    was_unrelaxed: bool,
}

impl OffsetKindModels {
    pub(super) fn new(vertices: usize, relaxed: bool) -> Self {
        Self {
            models: Decisions::new(RATES, &[INITIAL_WEIGHTS], [18, 27, 16]),
            has_relaxation: relaxed,
            unrelaxed: Decisions::new(RATES, &[[0.0]], [2]),
            coarser_edges: vec![],
            vertices: vec![false; vertices],
            edges: vec![],
            exception_counts: vec![],
            was_unrelaxed: false,
        }
    }

    pub(super) fn begin_level(&mut self, relations: &Relations) {
        self.edges = vec![false; relations.topology.edges.len()];
        self.exception_counts = vec![0; relations.topology.vertices];
    }

    pub(super) fn end_level(&mut self) {
        self.coarser_edges = std::mem::take(&mut self.edges);
        self.vertices.extend(&self.coarser_edges);
    }

    /// Code the kind of an edge's offset: scalar from the relaxed point, scalar from the unrelaxed point, or
    /// vector. `rough` is the log-magnitude of nearby errors.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        relations: &Relations,
        edge: usize,
        rough: f32,
        given: OffsetKind,
    ) -> Result<OffsetKind, Exhausted> {
        let near = relations.neighbours(edge).filter(|&e| self.edges[e]).count().min(2);
        let above = usize::from(relations.above(edge).is_some_and(|above| self.coarser_edges[above]));
        let sibling = usize::from(relations.sibling(edge).is_some_and(|sibling| self.edges[sibling]));
        let ends = relations.topology.edges[edge].map(|v| v as usize);
        let marked = ends.iter().filter(|&&v| self.vertices[v]).count();
        let around = ends.iter().map(|&v| usize::from(self.exception_counts[v])).sum::<usize>().min(8);
        let features = [1.0, near as f32, above as f32, sibling as f32, marked as f32, around as f32, rough];
        let contexts = [
            near + 3 * above + 6 * marked,
            around.min(8) + 9 * marked,
            ((2.0 * rough).max(0.0) as usize).min(15),
        ];
        let is_exception =
            self.models.code_bit(coder, 0, &features, &contexts, given != OffsetKind::Scalar)?;
        if !is_exception {
            return Ok(OffsetKind::Scalar);
        }
        self.edges[edge] = true;
        for v in ends {
            self.exception_counts[v] = self.exception_counts[v].saturating_add(1);
        }
        if !self.has_relaxation {
            return Ok(OffsetKind::Vector);
        }
        let context = [usize::from(self.was_unrelaxed)];
        self.was_unrelaxed =
            self.unrelaxed.code_bit(coder, 0, &[1.0], &context, given == OffsetKind::Unrelaxed)?;
        Ok(if self.was_unrelaxed { OffsetKind::Unrelaxed } else { OffsetKind::Vector })
    }
}

/// Kind of an offset.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum OffsetKind {
    Scalar,
    Unrelaxed,
    Vector,
}
