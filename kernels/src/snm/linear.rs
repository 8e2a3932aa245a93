//! Linear prediction with online learning by recursive least squares.

/// Initial and maximum variance of the weights.
const INITIAL_VARIANCE: f32 = 0.003;

/// Weights of `I` inputs, and their covariance.
#[derive(Clone, Copy)]
pub(super) struct LinearPredictor<const I: usize> {
    weights: [f32; I],
    /// Covariance of the weights, relative to the squared error.
    covariance: [[f32; I]; I],
}

impl<const I: usize> LinearPredictor<I> {
    pub(super) fn new(weights: [f32; I]) -> Self {
        let spread =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { INITIAL_VARIANCE } else { 0.0 }));
        Self { weights, covariance: spread }
    }

    /// Return the weighted sum of the inputs.
    pub(super) fn predict(&self, inputs: &[f32; I]) -> f32 {
        (0..I).map(|i| self.weights[i] * inputs[i]).sum()
    }

    /// Update the weights. `error` is the observed value minus the prediction, `noise` its typical magnitude.
    pub(super) fn learn(&mut self, inputs: &[f32; I], error: f32, noise: f32) {
        // Clamping keeps outliers from undoing what was learnt, and large numbers from overflowing.
        let error = (error / noise).clamp(-3.0, 3.0);
        let inputs = inputs.map(|x| (x / noise).clamp(-16.0, 16.0));
        let reach: [f32; I] =
            std::array::from_fn(|i| (0..I).map(|j| self.covariance[i][j] * inputs[j]).sum());
        let power = (0..I).map(|i| inputs[i] * reach[i]).sum::<f32>().max(0.0);
        let gain = 1.0 / (1.0 + power);
        for i in 0..I {
            self.weights[i] += gain * reach[i] * error;
            for j in 0..I {
                self.covariance[i][j] -= gain * reach[i] * reach[j];
            }
            // A minimum variance keeps weights adaptive, because regions of a mesh differ.
            if self.covariance[i][i] < INITIAL_VARIANCE {
                self.covariance[i][i] = self.covariance[i][i].max(1e-5) + 1e-6;
            }
        }
    }
}
