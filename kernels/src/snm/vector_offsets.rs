//! Coding of vector offsets: of boundary vertices, and of vertices that no scalar can reach.

use super::coder::{Coder, Exhausted};
use super::decisions::Rates;
use super::integers::{IntegerModels, NumberPrior};
use super::linear::LinearPredictor;
use super::logistic::{classify, ln};
use super::relations::Relations;
use crate::subdivision::snm_contents::Offset;

const MIN_MAGNITUDE: f32 = 1.0 / 16.0;

const RATES: Rates =
    Rates { regression: [0.1, 1e-5], mixer: [0.02, 1e-5], memory: 400, prior_weight: 4, min_probability: 16 };

/// Adaptive models of vector offsets.
pub(super) struct VectorModels {
    /// Predictor per component, first for interior exceptions, then for boundary vertices; and its mean
    /// absolute error. Inputs are the vectors of the parallel coarse edge and of the sibling edge.
    predictors: [LinearPredictor<2>; 6],
    mean_error: [f32; 6],
    models: IntegerModels<4, 2>,
    coarser_offsets: Vec<Offset>,
}

impl VectorModels {
    pub(super) fn new() -> Self {
        Self {
            predictors: [LinearPredictor::new([0.2, 0.1]); 6],
            mean_error: [4.0; 6],
            models: IntegerModels::new(RATES, &[[0.1, 0.6, 0.3, 0.1]], [6 * 16, 6 * 16], 6),
            coarser_offsets: vec![],
        }
    }

    pub(super) fn end_level(&mut self, offsets: &[Offset]) {
        self.coarser_offsets = offsets.to_vec();
    }

    /// Code the vector of an edge. `offsets` holds the offsets coded so far on this level.
    pub(super) fn code_vector<C: Coder>(
        &mut self,
        coder: &mut C,
        relations: &Relations,
        edge: usize,
        offsets: &[Offset],
        given: [i32; 3],
    ) -> Result<[i32; 3], Exhausted> {
        let above = vector_components(relations.above(edge).map(|e| self.coarser_offsets[e]));
        let sibling = vector_components(relations.sibling(edge).map(|e| offsets[e]));
        let boundary = relations.topology.is_boundary_edge(edge);
        let mut decoded = [0; 3];
        let mut unusual = 1.0;
        for axis in 0..3 {
            let kind = 3 * usize::from(boundary) + axis;
            let inputs = [above[axis], sibling[axis]];
            let predicted = self.predictors[kind].predict(&inputs).clamp(-1e9, 1e9);
            let centre = (predicted.abs() + 0.3).floor().copysign(predicted);
            let spread = self.mean_error[kind];
            let near = 0.125 * above[axis].abs() + 0.25 * sibling[axis].abs() + MIN_MAGNITUDE;
            let known = NumberPrior {
                expected: spread,
                features: [1.0, ln(spread), ln(spread * unusual), ln(near)],
                contexts: [spread, near].map(|x| 16 * kind + classify(x / MIN_MAGNITUDE, 1.0, 16)),
                sign_logit: (2.0 * (predicted - centre) / (spread + 0.1)).clamp(-3.0, 3.0),
                sign_context: kind,
            };
            let error = self.models.code(coder, &known, i64::from(given[axis]) - centre as i64)?;
            decoded[axis] = i32::try_from(centre as i64 + error).map_err(|_| Exhausted)?;
            let missed = (decoded[axis] as f32 - predicted).abs();
            self.predictors[kind].learn(&inputs, decoded[axis] as f32 - predicted, spread + 0.5);
            self.mean_error[kind] += 0.1 * (missed.min(64.0 * spread) + MIN_MAGNITUDE - spread);
            unusual = 0.3 * unusual + 0.7 * (missed + MIN_MAGNITUDE) / spread;
        }
        Ok(decoded)
    }
}

/// Return the components of a vector offset; zeros for a scalar, which refers to another axis.
fn vector_components(offset: Option<Offset>) -> [f32; 3] {
    match offset {
        Some(Offset::Vector(v)) => v.map(|x| x as f32),
        _ => [0.0; 3],
    }
}
