//! Linear prediction whose weights follow what is coded, by recursive least squares.

/// Variance of the weights at first, and at most.
const UNCERTAIN: f32 = 0.003;

/// Weights of `I` inputs, and how uncertain they still are.
#[derive(Clone, Copy)]
pub(super) struct Linear<const I: usize> {
    weights: [f32; I],
    /// Covariance of the weights, in errors squared.
    spread: [[f32; I]; I],
}

impl<const I: usize> Linear<I> {
    pub(super) fn new(weights: [f32; I]) -> Self {
        let spread = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { UNCERTAIN } else { 0.0 }));
        Self { weights, spread }
    }

    pub(super) fn predict(&self, inputs: &[f32; I]) -> f32 {
        (0..I).map(|i| self.weights[i] * inputs[i]).sum()
    }

    /// Move the weights towards the value that came; `noise` is what the prediction misses by as a rule.
    pub(super) fn learn(&mut self, inputs: &[f32; I], error: f32, noise: f32) {
        // An outlier must not undo what many have taught, nor a large number overflow.
        let error = (error / noise).clamp(-3.0, 3.0);
        let inputs = inputs.map(|x| (x / noise).clamp(-16.0, 16.0));
        let reach: [f32; I] = std::array::from_fn(|i| (0..I).map(|j| self.spread[i][j] * inputs[j]).sum());
        let power = (0..I).map(|i| inputs[i] * reach[i]).sum::<f32>().max(0.0);
        let gain = 1.0 / (1.0 + power);
        for i in 0..I {
            self.weights[i] += gain * reach[i] * error;
            for j in 0..I {
                self.spread[i][j] -= gain * reach[i] * reach[j];
            }
            // Weights stay a little uncertain: one part of a mesh is not like the other.
            if self.spread[i][i] < UNCERTAIN {
                self.spread[i][i] = self.spread[i][i].max(1e-5) + 1e-6;
            }
        }
    }
}
