//! Coding of scalar offsets, in steps.
//!
//! Three predictions are weighted by their accuracy nearby. The first is zero. The second uses coded
//! neighbours and the parallel edge of the coarser level, whose offset is four times as large on a smooth
//! surface. The third also uses the caller's shape prediction. The residual is coded with a magnitude
//! estimated from its surroundings.

use crate::subdivision::topology::NONE;

use super::coder::{Coder, Exhausted};
use super::decisions::Rates;
use super::integers::{IntegerModels, NumberPrior};
use super::linear::LinearPredictor;
use super::logistic::{classify, ln};
use super::relations::Relations;

/// Unit of `expected`, in steps.
const EXPECTED_UNIT: f32 = 1.0 / 16.0;
/// Minimum expected magnitude, in steps.
const MIN_MAGNITUDE: f32 = 1.0 / 16.0;
/// Expected decrease of errors per level, as a ratio of lengths.
const DECAY: f32 = 0.5;

const RATES: Rates =
    Rates { regression: [0.1, 1e-4], mixer: [0.03, 1e-6], memory: 400, prior_weight: 3, min_probability: 16 };

// Initial weights, fitted to horse, cow, bunny, igea, rocker-arm and fandisk.

/// Prediction weights by the number of coded neighbours, with and without shape; see [`ScalarModels::predict`].
const SHAPE_WEIGHTS: [[f32; 7]; 5] = [
    [0.05, 0.58, 0.2, 0.25, 0.06, 0.03, -0.13],
    [0.05, 0.58, 0.09, 0.25, 0.03, 0.01, -0.08],
    [0.05, 0.63, 0.32, 0.11, 0.0, -0.05, -0.04],
    [0.06, 0.63, 0.44, 0.2, -0.01, -0.08, 0.0],
    [0.06, 0.58, 0.64, 0.3, -0.01, -0.11, 0.0],
];
const NO_SHAPE_WEIGHTS: [[f32; 4]; 5] = [
    [0.14, 0.4, 0.05, -0.14],
    [0.13, 0.28, 0.01, -0.08],
    [0.14, 0.46, -0.08, -0.05],
    [0.17, 0.68, -0.12, 0.0],
    [0.16, 0.97, -0.16, 0.0],
];
/// Feature weights of the first unary steps of a magnitude; see [`ScalarModels::estimate_prior`].
const UNARY_STEP_WEIGHTS: [[f32; 10]; 5] = [
    [1.3, -0.25, 0.02, 0.12, 0.05, 1.0, 0.25, 0.35, 0.42, 0.55],
    [-0.05, 0.12, 0.23, 0.06, 0.12, 0.75, 0.37, 0.48, 0.43, 0.37],
    [-0.5, 0.15, 0.16, -0.02, 0.06, 0.28, 0.34, 0.34, 0.37, 0.0],
    [-0.35, 0.1, 0.1, 0.0, 0.08, 0.16, 0.34, 0.2, 0.23, -0.1],
    [-0.13, 0.13, 0.05, -0.04, 0.03, 0.12, 0.25, 0.1, 0.14, -0.08],
];

/// Statistics of a coded edge.
#[derive(Clone, Copy, Default)]
struct CodedEdge {
    /// True if its offset is a scalar.
    is_scalar: bool,
    value: f32,
    /// Value minus the shape prediction, and value minus the weighted prediction.
    shape_error: f32,
    error: f32,
    /// Errors of the three predictions.
    prediction_errors: [f32; 3],
}

/// Adaptive models of scalar offsets.
pub(super) struct ScalarModels {
    /// Step of a level in steps of the next finer level.
    step_ratio: f32,
    with_shape: [LinearPredictor<7>; 5],
    without_shape: [LinearPredictor<4>; 5],
    /// Mean squared errors of the three predictions.
    mean_error2: [f32; 3],
    models: IntegerModels<10, 7>,
    coarser_edges: Vec<CodedEdge>,
    edges: Vec<CodedEdge>,
    /// Mean error at the edges of each vertex on the coarser level, in steps of this level.
    coarser_errors: Vec<f32>,
    /// Sum and count of errors at the coded edges of each vertex.
    vertex_errors: Vec<[f32; 2]>,
}

/// Inputs and results of predicting an offset.
struct Prediction {
    neighbours: usize,
    inputs: [f32; 7],
    shapeless: [f32; 4],
    candidates: [f32; 3],
    weighted: f32,
}

impl ScalarModels {
    pub(super) fn new(step_ratio: f32, vertices: usize) -> Self {
        Self {
            step_ratio,
            with_shape: SHAPE_WEIGHTS.map(LinearPredictor::new),
            without_shape: NO_SHAPE_WEIGHTS.map(LinearPredictor::new),
            mean_error2: [1.0; 3],
            models: IntegerModels::new(RATES, &UNARY_STEP_WEIGHTS, [16, 16, 16, 32, 64, 64, 96], 16),
            coarser_edges: vec![],
            edges: vec![],
            coarser_errors: vec![0.0; vertices],
            vertex_errors: vec![],
        }
    }

    pub(super) fn begin_level(&mut self, relations: &Relations) {
        self.edges = vec![CodedEdge::default(); relations.topology.edges.len()];
        self.vertex_errors = vec![[0.0; 2]; relations.topology.vertices];
    }

    pub(super) fn end_level(&mut self, relations: &Relations) {
        let scale = DECAY * self.step_ratio;
        let mean = |[sum, count]: &[f32; 2]| scale * sum / count.max(1.0);
        self.coarser_errors = self.vertex_errors.iter().map(mean).collect();
        for (edge, ends) in self.edges.iter().zip(&relations.topology.edges) {
            let [a, b] = ends.map(|v| self.coarser_errors[v as usize]);
            self.coarser_errors.push(0.3 * scale * edge.error.abs() + 0.35 * (a + b));
        }
        self.coarser_edges = std::mem::take(&mut self.edges);
    }

    /// Code the scalar of an edge. `expected` is the caller's shape prediction, in 1/16 steps.
    pub(super) fn code_scalar<C: Coder>(
        &mut self,
        coder: &mut C,
        relations: &Relations,
        edge: usize,
        expected: i32,
        given: i32,
    ) -> Result<i32, Exhausted> {
        let shape = expected as f32 * EXPECTED_UNIT;
        let prediction = self.predict(relations, edge, shape);
        // Small offsets are mostly 0, as encoders prefer, so the prediction only biases the sign.
        let centre = if prediction.weighted.abs() < 6.0 { 0.0 } else { prediction.weighted.trunc() };
        let known =
            self.estimate_prior(relations, edge, shape, prediction.weighted, prediction.weighted - centre);
        let error = self.models.code(coder, &known, i64::from(given) - centre as i64)?;
        let value = i32::try_from(centre as i64 + error).map_err(|_| Exhausted)?;
        self.learn(relations, edge, shape, &prediction, value as f32, known.expected + 0.5);
        Ok(value)
    }

    /// Estimate the logarithm of the error magnitude around an edge.
    pub(super) fn estimate_roughness(&self, relations: &Relations, edge: usize) -> f32 {
        let [a, b] = relations.topology.edges[edge].map(|v| {
            let [sum, count] = self.vertex_errors[v as usize];
            self.coarser_errors[v as usize] + sum / count.max(1.0)
        });
        ln(0.5 * (a + b) + MIN_MAGNITUDE) - ln(MIN_MAGNITUDE)
    }

    fn parallel_coarse_edge(&self, relations: &Relations, edge: usize) -> CodedEdge {
        relations.above(edge).map_or(CodedEdge::default(), |above| self.coarser_edges[above])
    }

    fn predict(&self, relations: &Relations, edge: usize, shape: f32) -> Prediction {
        let ratio = self.step_ratio;
        let above = self.parallel_coarse_edge(relations, edge);
        let (mut count, mut values, mut surprises, mut parents) = (0usize, 0.0, 0.0, 0.0);
        let mut missed = above.prediction_errors.map(|x| (0.25 * ratio * x) * (0.25 * ratio * x));
        for e in relations.neighbours(edge) {
            parents += 0.25 * ratio * self.parallel_coarse_edge(relations, e).value;
            let near = &self.edges[e];
            if near.is_scalar {
                count += 1;
                values += near.value;
                surprises += near.shape_error;
                for (sum, x) in missed.iter_mut().zip(near.prediction_errors) {
                    *sum += x * x;
                }
            }
        }
        let share = 1.0 / count.max(1) as f32;
        let sibling = relations.sibling(edge).map_or(CodedEdge::default(), |e| self.edges[e]);
        let inputs = [
            above.value * ratio,
            shape,
            values * share,
            surprises * share,
            above.shape_error * ratio,
            parents,
            sibling.shape_error,
        ];
        let shapeless = [above.value * ratio, values * share, parents, sibling.value];
        let each = [
            0.0,
            self.without_shape[count].predict(&shapeless).clamp(-1e9, 1e9),
            self.with_shape[count].predict(&inputs).clamp(-1e9, 1e9),
        ];
        let poor: [f32; 3] = std::array::from_fn(|i| missed[i] + 16.0 * self.mean_error2[i] + 0.1);
        let best = poor[0].min(poor[1]).min(poor[2]);
        let weights = poor.map(|x| {
            let square = (best / x) * (best / x);
            square * square
        });
        let weighed = (0..3).map(|i| weights[i] * each[i]).sum::<f32>() / weights.iter().sum::<f32>();
        Prediction { neighbours: count, inputs, shapeless, candidates: each, weighted: weighed }
    }

    /// Compute the prior for the magnitude of an error. `fraction` is the prediction's distance from a whole
    /// number.
    fn estimate_prior(
        &self,
        relations: &Relations,
        edge: usize,
        shape: f32,
        predicted: f32,
        fraction: f32,
    ) -> NumberPrior<10, 7> {
        let (mut count, mut errors, mut values) = (0.0f32, 0.0, 0.0);
        for e in relations.neighbours(edge).filter(|&e| self.edges[e].is_scalar) {
            count += 1.0;
            errors += self.edges[e].error.abs();
            values += self.edges[e].value.abs();
        }
        let mean = |vertices: [u32; 2]| {
            let (mut sum, mut count, mut active, mut ends) = (0.0, 0.0f32, 0.0, 0.0f32);
            for v in vertices.into_iter().filter(|&v| v != NONE) {
                sum += self.vertex_errors[v as usize][0];
                count += self.vertex_errors[v as usize][1];
                active += self.coarser_errors[v as usize];
                ends += 1.0;
            }
            [sum / count.max(1.0) + MIN_MAGNITUDE, active / ends.max(1.0) + MIN_MAGNITUDE]
        };
        let beside = errors / count.max(1.0) + MIN_MAGNITUDE;
        let values = values / count.max(1.0) + MIN_MAGNITUDE;
        let above =
            0.25 * self.step_ratio * self.parallel_coarse_edge(relations, edge).error.abs() + MIN_MAGNITUDE;
        let own = predicted.abs() + MIN_MAGNITUDE;
        let [ends, ends_before] = mean(relations.topology.edges[edge]);
        let [across, across_before] = mean(relations.topology.opposite_corners(edge));
        let expected = 0.25 * ends_before + 0.2 * beside + 0.35 * ends + 0.2 * above;
        let octave = |x: f32, count| classify(x / MIN_MAGNITUDE, 1.0, count);
        NumberPrior {
            expected,
            features: [
                1.0,
                ln(ends_before),
                ln(beside),
                ln(values),
                ln(above),
                ln(own),
                ln(ends),
                ln(shape.abs() + MIN_MAGNITUDE),
                ln(across),
                ln(across_before),
            ],
            contexts: [
                octave(beside, 16),
                octave(above, 16),
                octave(own, 16),
                classify(expected / MIN_MAGNITUDE, 2.0, 32),
                8 * octave(ends_before, 8) + octave(ends, 8),
                8 * octave(across_before, 8) + octave(across, 8),
                8 * classify((fraction.abs() + MIN_MAGNITUDE) / MIN_MAGNITUDE, 1.5, 12) + octave(expected, 8),
            ],
            sign_logit: (5.0 * fraction / (expected + 0.05)).clamp(-6.0, 6.0),
            sign_context: octave(fraction.abs() + MIN_MAGNITUDE, 8) + if fraction < 0.0 { 8 } else { 0 },
        }
    }

    fn learn(
        &mut self,
        relations: &Relations,
        edge: usize,
        shape: f32,
        prediction: &Prediction,
        value: f32,
        noise: f32,
    ) {
        let missed = prediction.candidates.map(|predicted| value - predicted);
        self.without_shape[prediction.neighbours].learn(&prediction.shapeless, missed[1], noise);
        self.with_shape[prediction.neighbours].learn(&prediction.inputs, missed[2], noise);
        for (mean, x) in self.mean_error2.iter_mut().zip(missed) {
            *mean += 0.02 * ((x * x).min(1e12) - *mean);
        }
        let error = value - prediction.weighted;
        self.edges[edge] = CodedEdge {
            is_scalar: true,
            value,
            shape_error: value - shape,
            error,
            prediction_errors: missed,
        };
        for v in relations.topology.edges[edge] {
            let [sum, count] = &mut self.vertex_errors[v as usize];
            *sum += error.abs();
            *count += 1.0;
        }
    }
}
