//! Coding of the channels of new vertices, as residuals of the caller's prediction.

use crate::subdivision::topology::NONE;

use super::coder::{Coder, Exhausted};
use super::decisions::Rates;
use super::integers::{IntegerModels, NumberPrior};
use super::linear::LinearPredictor;
use super::logistic::{classify, ln};
use super::relations::Relations;

const MIN_MAGNITUDE: f32 = 1.0 / 16.0;

const RATES: Rates = Rates {
    regression: [0.04, 1e-4],
    mixer: [0.03, 1e-6],
    memory: 400,
    prior_weight: 3,
    min_probability: 16,
};

/// Adaptive models of vertex channels.
pub(super) struct ChannelModels {
    count: usize,
    /// Predictor per channel. Inputs: earlier channels of the vertex (3), mean of neighbours, parallel coarse
    /// edge, and the difference between opposite corners and edge ends.
    predictors: [LinearPredictor<6>; 4],
    models: IntegerModels<6, 5>,
    coarser_values: Vec<[i32; 4]>,
    /// Channels of all vertices; a new vertex has the mean of its edge's ends plus the coded residual.
    vertices: Vec<[f32; 4]>,
}

impl ChannelModels {
    pub(super) fn new(count: usize, base: &[[i32; 4]]) -> Self {
        Self {
            count,
            predictors: [LinearPredictor::new([0.0, 0.0, 0.0, 0.1, 0.05, 0.1]); 4],
            models: IntegerModels::new(
                RATES,
                &[[0.0, 0.3, 0.2, 0.1, 0.1, 0.3]],
                [4 * 16, 4 * 16, 4 * 16, 4 * 32, 4 * 16],
                8,
            ),
            coarser_values: vec![],
            vertices: base.iter().map(|values| values.map(|x| x as f32)).collect(),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Code the channels of all edges.
    pub(super) fn code_level<C: Coder>(
        &mut self,
        coder: &mut C,
        relations: &Relations,
        given: Option<&[[i32; 4]]>,
    ) -> Result<Vec<[i32; 4]>, Exhausted> {
        if self.count == 0 {
            return Ok(vec![]);
        }
        let edges = relations.topology.edges.len();
        let mut values = vec![[0; 4]; edges];
        // Absolute prediction errors; negative for edges that are not coded yet.
        let mut missed = vec![[-1.0f32; 4]; edges];
        for &edge in &relations.order {
            let edge = edge as usize;
            for channel in 0..self.count {
                let given = given.map_or(0, |given| given[edge][channel]);
                let error = self.code_channel(coder, relations, edge, channel, (&values, &missed), given)?;
                (values[edge][channel], missed[edge][channel]) = error;
            }
        }
        for (coded, ends) in values.iter().zip(&relations.topology.edges) {
            let [a, b] = ends.map(|v| self.vertices[v as usize]);
            self.vertices.push(std::array::from_fn(|i| 0.5 * (a[i] + b[i]) + coded[i] as f32));
        }
        self.coarser_values.clone_from(&values);
        Ok(values)
    }

    fn code_channel<C: Coder>(
        &mut self,
        coder: &mut C,
        relations: &Relations,
        edge: usize,
        channel: usize,
        (values, missed): (&[[i32; 4]], &[[f32; 4]]),
        given: i32,
    ) -> Result<(i32, f32), Exhausted> {
        let (mut count, mut sum, mut errors) = (0.0f32, 0.0, 0.0);
        for e in relations.neighbours(edge).filter(|&e| missed[e][channel] >= 0.0) {
            count += 1.0;
            sum += values[e][channel] as f32;
            errors += missed[e][channel];
        }
        let above = relations.above(edge).map_or(0.0, |e| self.coarser_values[e][channel] as f32);
        let value = |v: u32| self.vertices[v as usize][channel];
        let [a, b] = relations.topology.edges[edge].map(value);
        let across = relations
            .topology
            .opposite_corners(edge)
            .map(|v| if v == NONE { 0.5 * (a + b) } else { value(v) });
        let bend = 0.5 * (across[0] + across[1] - a - b);
        let mut inputs = [0.0, 0.0, 0.0, sum / count.max(1.0), above, bend];
        let mut last = 1.0;
        for earlier in 0..channel {
            inputs[earlier] = values[edge][earlier] as f32;
            last = missed[edge][earlier] + MIN_MAGNITUDE;
        }
        let predicted = self.predictors[channel].predict(&inputs).clamp(-1e9, 1e9);
        let centre = (predicted.abs() + 0.3).floor().copysign(predicted);
        let fraction = predicted - centre;
        let beside = errors / count.max(1.0) + MIN_MAGNITUDE;
        let above = 0.5 * above.abs() + MIN_MAGNITUDE;
        let own = predicted.abs() + MIN_MAGNITUDE;
        let slope = 0.25 * (a - b).abs() + MIN_MAGNITUDE;
        let expected = 0.3 * (beside + slope) + 0.2 * (last + above);
        let octave = |x: f32| 16 * channel + classify(x / MIN_MAGNITUDE, 1.0, 16);
        let known = NumberPrior {
            expected,
            features: [1.0, ln(beside), ln(last), ln(above), ln(own), ln(slope)],
            contexts: [
                octave(beside),
                octave(last),
                octave(above),
                32 * channel + classify(expected / MIN_MAGNITUDE, 2.0, 32),
                octave(slope),
            ],
            sign_logit: (2.0 * fraction / (expected + 0.1)).clamp(-3.0, 3.0),
            sign_context: 2 * channel + usize::from(fraction < 0.0),
        };
        let error = self.models.code(coder, &known, i64::from(given) - centre as i64)?;
        let value = i32::try_from(centre as i64 + error).map_err(|_| Exhausted)?;
        let error = value as f32 - predicted;
        self.predictors[channel].learn(&inputs, error, expected + 0.5);
        Ok((value, error.abs()))
    }
}
