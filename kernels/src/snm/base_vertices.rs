//! Coding of the base mesh's vertex positions, as residuals of a prediction.
//!
//! The tip of a triangle is predicted linearly from three surrounding corners, in the [`Frame`] of its gate.
//! Errors have different sizes along the axes of the frame: they are smaller across the plane of the known
//! triangle than within it. Positions are integers along other axes. Each coordinate is therefore coded under
//! a normal distribution of that shape, conditioned on the coordinates before it.

use super::coder::{Coder, Exhausted};
use super::decisions::{Decisions, Rates};
use super::frame::{CovarianceFactors, GateFrame};
use super::integers::{IntegerModels, NumberPrior};
use super::linear::LinearPredictor;
use super::logistic::ln;
use super::region::Region;

/// Learning rates of all models of the base mesh.
pub(super) const RATES: Rates = Rates {
    regression: [0.2, 1e-4],
    mixer: [0.02, 1e-5],
    memory: 250,
    prior_weight: 12,
    min_probability: 512,
};

/// Number of inputs: a constant 1 and the coordinates of three corners. The corner opposite the gate has no
/// third one.
const INPUT_COUNT: usize = 9;
/// Initial weights per axis, from least squares over the base meshes of nine scans.
const TIP_WEIGHTS: [[f32; INPUT_COUNT]; 3] = [
    [-0.25, -0.18, 0.04, 0.33, -0.09, -0.01, 0.06, 0.06, 0.02],
    [0.14, 0.03, -0.18, 0.1, 0.28, 0.0, -0.07, -0.03, -0.01],
    [0.01, 0.0, 0.02, 0.0, 0.01, 0.26, 0.01, 0.02, -0.02],
];

/// Scale of Student's t distribution, relative to the mean deviation.
const STUDENT_SCALE: f64 = 0.72;

/// Predicted tip of a triangle.
pub(super) struct TipPrediction {
    pub frame: GateFrame,
    inputs: [f32; INPUT_COUNT],
    /// Predicted position in the frame, and in grid coordinates.
    pub local: [f64; 3],
    pub point: [f64; 3],
    /// Ends of the gate.
    pub ends: [u32; 2],
}

/// Adaptive models of base vertices: positions and channels.
pub(super) struct VertexModels {
    tips: [LinearPredictor<INPUT_COUNT>; 3],
    /// Deviation of tips from their prediction along the frame axes, in edge lengths.
    deviations: [f64; 3],
    first: IntegerModels<1, 0>,
    positions: IntegerModels<3, 1>,
    /// Predictor of a channel from the channels before it.
    colors: [LinearPredictor<3>; 4],
    channels: IntegerModels<3, 1>,
    more: Decisions<1, 0>,
}

impl VertexModels {
    pub(super) fn new() -> Self {
        Self {
            tips: TIP_WEIGHTS.map(LinearPredictor::new),
            deviations: [0.37, 0.27, 0.15],
            first: IntegerModels::new(RATES, &[[0.0]], [], 1),
            positions: IntegerModels::new(RATES, &[[0.1, 0.5, 0.4]], [3], 1),
            colors: [LinearPredictor::new([0.0; 3]); 4],
            channels: IntegerModels::new(RATES, &[[0.0, 0.7, 0.3]], [4], 4),
            more: Decisions::new(RATES, &[[-2.0]], []),
        }
    }

    /// Code whether another component follows.
    pub(super) fn more<C: Coder>(&mut self, coder: &mut C, more: bool) -> Result<bool, Exhausted> {
        self.more.code_bit(coder, 0, &[1.0], &[], more)
    }

    /// Predict the tip of a triangle on `gate`.
    pub(super) fn predict_tip(&self, region: &Region, gate: u32) -> TipPrediction {
        let frame = region.frame(gate);
        let [across, next, previous] = region
            .neighbouring_corners(gate)
            .map(|v| frame.to_local(region.position(v)).map(|x| x.clamp(-4.0, 4.0) as f32));
        let inputs =
            [1.0, across[0], across[1], next[0], next[1], next[2], previous[0], previous[1], previous[2]];
        let local = [0, 1, 2].map(|i| f64::from(self.tips[i].predict(&inputs).clamp(-4.0, 4.0)));
        let point = frame.to_grid(local);
        let ends = [region.border.edge(gate).origin, region.border.target(gate)];
        TipPrediction { frame, inputs, local, point, ends }
    }

    /// Code a corner of the first triangle of a component. `near` is the previous vertex.
    pub(super) fn first<C: Coder>(
        &mut self,
        coder: &mut C,
        near: [i32; 3],
        given: Option<[i32; 3]>,
    ) -> Result<[i32; 3], Exhausted> {
        let mut position = [0; 3];
        for axis in 0..3 {
            let near = i64::from(near[axis]);
            let residual = given.map_or(0, |p| i64::from(p[axis]) - near);
            let known = NumberPrior {
                expected: 1024.0,
                features: [1.0],
                contexts: [],
                sign_logit: 0.0,
                sign_context: 0,
            };
            let residual = self.first.code(coder, &known, residual)?;
            position[axis] = i32::try_from(near + residual).map_err(|_| Exhausted)?;
        }
        Ok(position)
    }

    /// Code the position of a new tip, and update the models.
    pub(super) fn code_tip<C: Coder>(
        &mut self,
        coder: &mut C,
        guess: &TipPrediction,
        given: Option<[i32; 3]>,
    ) -> Result<[i32; 3], Exhausted> {
        let CovarianceFactors { below, variances } = guess.frame.factor_covariance(self.deviations);
        let mut position = [0; 3];
        let mut apart = [0.0; 3];
        let mut unusual = 1.0f32;
        for axis in 0..3 {
            let shift: f64 = (0..axis).map(|j| below[axis][j] * apart[j]).sum();
            let near = (guess.point[axis] + shift).clamp(i32::MIN.into(), i32::MAX.into());
            let start = (near + 0.5).floor() as i64;
            let residual = given.map_or(0, |p| i64::from(p[axis]) - start);
            let expected = 0.8 * variances[axis].sqrt() as f32;
            let features = [1.0, ln(expected), ln(expected * unusual)];
            // With an expected magnitude of 8 or more, the lowest bit is coded with probability 1/2. Every
            // vertex thus takes at least one bit, and no file can declare more vertices than it has bits.
            let bounded = if axis == 0 { expected.max(8.0) } else { expected };
            let known = NumberPrior {
                expected: bounded,
                features,
                contexts: [axis],
                sign_logit: 0.0,
                sign_context: 0,
            };
            let residual = self.positions.code(coder, &known, residual)?;
            position[axis] = i32::try_from(start + residual).map_err(|_| Exhausted)?;
            apart[axis] = f64::from(position[axis]) - near;
            unusual = 0.5 * unusual + 0.5 * (apart[axis].abs() as f32 / expected + 0.1);
        }
        let found = guess.frame.to_local(position.map(f64::from));
        for (axis, deviation) in self.deviations.iter_mut().enumerate() {
            let error = found[axis] - guess.local[axis];
            self.tips[axis].learn(&guess.inputs, error as f32, *deviation as f32);
            // For a normal distribution, the standard deviation is 1.25 times the mean absolute deviation.
            *deviation = (*deviation + 0.02 * (1.25 * error.abs().min(4.0) - *deviation)).max(1e-3);
        }
        Ok(position)
    }

    /// Estimate the extra bits of a tip position over the most likely one. Errors along each axis follow
    /// Student's t distribution with three degrees of freedom.
    pub(super) fn estimate_bits(&self, guess: &TipPrediction, p: &[i32; 3]) -> f64 {
        let local = guess.frame.to_local(p.map(f64::from));
        let along = |axis: usize| {
            let off = (local[axis] - guess.local[axis]) / (STUDENT_SCALE * self.deviations[axis]);
            2.0 * f64::from(ln((1.0 + off * off / 3.0) as f32)) * std::f64::consts::LOG2_E
        };
        (0..3).map(along).sum()
    }

    /// Code the first `count` channels of a vertex, with `near` as prediction.
    pub(super) fn channels<C: Coder>(
        &mut self,
        coder: &mut C,
        near: [i32; 4],
        count: usize,
        given: Option<[i32; 4]>,
    ) -> Result<[i32; 4], Exhausted> {
        let mut values = [0; 4];
        let mut residuals = [0.0; 3];
        let mut last = 8.0f32;
        for channel in 0..count {
            let shift = self.colors[channel].predict(&residuals).clamp(-1e9, 1e9);
            let start = i64::from(near[channel]) + (shift + 0.5).floor() as i64;
            let residual = given.map_or(0, |values| i64::from(values[channel]) - start);
            let features = [1.0, ln(last), if channel == 0 { 0.0 } else { ln(8.0) }];
            let known = NumberPrior {
                expected: last,
                features,
                contexts: [channel],
                sign_logit: 0.0,
                sign_context: channel,
            };
            let residual = self.channels.code(coder, &known, residual)?;
            values[channel] = i32::try_from(start + residual).map_err(|_| Exhausted)?;
            let apart = (i64::from(values[channel]) - i64::from(near[channel])) as f32;
            self.colors[channel].learn(&residuals, apart - shift, last);
            if let Some(slot) = residuals.get_mut(channel) {
                *slot = apart;
            }
            last = 0.5 * (last + residual.unsigned_abs() as f32) + 0.5;
        }
        Ok(values)
    }
}
